"""Trained runs as graphs that other runtimes run: ONNX, and torch's own export."""
