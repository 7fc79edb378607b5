"""PROGRAM: the drone. `flight` is what happens around a mission, `offloading` where its calls run."""
