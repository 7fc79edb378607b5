"""Cameras: the files of a folder, video devices and streams.

Laws. A photo is a JPEG that was captured after its request. A source that fails is a CameraError that names it and
the remedy, and is tried again. A driver that hangs does not hold up the flight or the end of the program.

- camera.py       the photos of a folder, in name order
- video.py        a device, stream, pipeline or video file, through OpenCV; a thread reads every frame
- album.py        the photos of a flight as files, with where each was taken
- calibration.py  a lens, from the file of a calibration
- terrain.py      the ground below, by a grid that GDAL reads

Ugly: OpenCV prints its warnings itself, and can be silenced only before it is imported or opens its first source.
GStreamer aborts a program that ends while it reads, so `close` waits a second for the thread.
"""
