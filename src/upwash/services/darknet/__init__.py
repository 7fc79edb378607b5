"""Darknet's models: a `.cfg` that says which layers, a `.weights` with their numbers, read and turned into ONNX."""
