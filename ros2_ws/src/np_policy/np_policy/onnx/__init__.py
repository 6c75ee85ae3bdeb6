"""A policy as one ONNX file: exporting it, running it without PyTorch, holding it to PyTorch."""
