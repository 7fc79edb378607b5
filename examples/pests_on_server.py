"""The server's implementation of the beetle counter: the same name, methods and types, another way to the answer."""

import cv2
import numpy as np
from pests import Beetles, red

from upwash import service


@service(name="beetlecounter")
class ThoroughBeetleCounter:
    """Counts: at full size, one by one, with those that touch each other told apart."""

    least_radius_px = 3.0

    def count(self, photo: bytes) -> Beetles:
        """How many beetles are in the photo."""
        image = cv2.imdecode(np.frombuffer(photo, np.uint8), cv2.IMREAD_COLOR)
        if image is None:
            raise ValueError("this is no photo")
        depth_px = cv2.distanceTransform(red(image), cv2.DIST_L2, 5)
        deepest = cv2.dilate(depth_px, np.ones((9, 9), np.uint8))
        middles = ((depth_px == deepest) & (depth_px >= self.least_radius_px)).astype(np.uint8)
        middles = cv2.dilate(
            middles, np.ones((5, 5), np.uint8)
        )  # one middle where the deepest pixels are several
        found, _ = cv2.connectedComponents(middles)
        return Beetles(found - 1, counted=True)  # the background is a component too
