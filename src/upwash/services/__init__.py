"""Services that come with upwash: what a drone can have computed on itself or on an edge server."""

from upwash.services.hotspots import Box, Detection, HotSpotDetector, Mode, NotAPhoto

Detector = HotSpotDetector  # the one that the bundled missions use

__all__ = ["Box", "Detection", "Detector", "HotSpotDetector", "Mode", "NotAPhoto"]
