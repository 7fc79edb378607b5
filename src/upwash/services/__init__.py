"""Services that come with upwash: what a drone can have computed on itself or on an edge server."""

from upwash.services.darknet.heads import Head
from upwash.services.detection import Box, Detection, Mode
from upwash.services.detector import Detector
from upwash.services.inference import ModelFiles
from upwash.services.photo import NotAPhoto
from upwash.services.shrink import Shrink

__all__ = ["Box", "Detection", "Detector", "Head", "Mode", "ModelFiles", "NotAPhoto", "Shrink"]
