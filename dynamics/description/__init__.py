"""Arm descriptions: links, joints, modes, parallel drives and arm files."""
