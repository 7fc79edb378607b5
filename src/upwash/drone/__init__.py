"""PROGRAM: the drone. `flight` prepares, runs and ends a mission; `offloading` decides where its calls run."""
