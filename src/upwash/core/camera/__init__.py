"""The camera: where what a photo shows lies on the ground.

Laws: a place has the radius that holds the object with 95 % probability, or a sentence says why it is unknown. What
was assumed is named (georeference.py). A frame that a stalled stream kept back is never taken for a new one
(frame_times.py).

    lens           pixels → directions from the vehicle
    georeference   directions, pose and ground → places
    frame_times    arrivals of frames → their times of capture
"""
