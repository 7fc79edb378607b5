"""No part of a password of a camera's source is shown."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.support.camera_source import shown_source

SECRET = "S3cret"


@pytest.mark.parametrize(
    ("source", "shown"),
    [
        (0, "0"),
        ("/dev/video0", "/dev/video0"),
        ("flights/a@b.mp4", "flights/a@b.mp4"),
        ("http://127.0.0.1:9/none", "http://127.0.0.1:9/none"),
        ("rtsp://[fe80::1%25wlan0]:554/x", "rtsp://[fe80::1%25wlan0]:554/x"),
        ("http://127.0.0.1:8182/v.cgi?user=admin&pwd=S3cret", "http://127.0.0.1:8182/v.cgi…"),
        ("http://10.0.0.2/v?S3cret", "http://10.0.0.2/v…"),
        ("http://10.0.0.2/v#S3cret", "http://10.0.0.2/v…"),
        ("rtsp://10.0.0.2:554/user=admin_password=S3cret_channel=1.sdp", "rtsp://10.0.0.2:554/user…"),
        ("rtsp://10.0.0.2/v;token=S3cret", "rtsp://10.0.0.2/v…"),
        ("http://cam:80/v?pwd=S3cret@S3cret", "http://cam/…"),
        ("http://admin:S3cret@127.0.0.1:8182/v", "http://127.0.0.1:8182/v"),
        ("http://admin:S3cret@S3cret@127.0.0.1:8182/v", "http://127.0.0.1:8182/v"),
        ("rtsp://admin:S3cret/S3cret@10.0.0.2/v", "rtsp://admin/…"),
        ("rtsp://admin:S3cret@S3cret/S3cret@10.0.0.2/v", "rtsp://…"),
        ("rtsp://admin:S3cret ! S3cret@10.0.0.2/v", "rtsp://10.0.0.2/v"),
        ("rtsp://admin:S3cret", "rtsp://…"),
        ("admin:S3cret@10.0.0.2/v", "10.0.0.2/v"),
        ("v4l2src device=/dev/video2 ! appsink", "v4l2src device=/dev/video2 ! appsink"),
        (
            'rtspsrc location="rtsp://u:S3cret S3cret@10.0.0.2/v?k=S3cret" user-id=u user-pw=S3cret ! appsink',
            "rtspsrc location=rtsp://10.0.0.2/v… user-id=u user-pw=… ! appsink",
        ),
        ("souphttpsrc extra-headers='a S3cret' ! appsink", "souphttpsrc extra-headers=… ! appsink"),
    ],
)
def test_a_source_is_shown_without_what_may_be_secret(source: int | str, shown: str) -> None:
    assert shown_source(source) == shown
    assert SECRET not in shown


@given(
    before=st.text(alphabet="@/?#&=;: !%x", max_size=4),
    after=st.text(alphabet="@/?#&=;: !%x", max_size=4),
    source=st.sampled_from(
        [
            "rtsp://admin:{}@10.0.0.2:554/v",
            "http://10.0.0.2/v?user=admin&pwd={}",
            "http://10.0.0.2:81/v?token={}&channel=1",
            "rtsp://admin:{}@10.0.0.2/v?x=1",
        ]
    ),
)
def test_no_mark_in_a_password_lets_a_part_of_it_out(before: str, after: str, source: str) -> None:
    assert SECRET not in shown_source(source.format(f"{before}{SECRET}{after}"))
