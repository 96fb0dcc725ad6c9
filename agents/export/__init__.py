"""Trained policies as files for other programs: a C header, an ONNX graph."""
