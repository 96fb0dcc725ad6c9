"""Arms as data: links, joints, modes, drives and files."""
