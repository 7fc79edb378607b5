"""The core decides, and does nothing else: plain values in, plain values out."""
