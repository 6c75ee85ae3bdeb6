"""The lens of a recording's images."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from np_description.calibration import Lens
from np_description.message_arrays import camera_info_lens
from np_record.bag import Recording


def read_lenses(recording: Recording) -> Iterator[tuple[Lens, np.ndarray]]:
    """The lens of each camera_info (`camera_info_lens`). Raises BagError.

    A recording of ours that was made with a calibration has turned images, also where their frame does not show it.
    """
    is_turned = bool(recording.counts.get("camera/camera_info")) and bool(
        recording.information_or_none.get("calibration")
    )
    for _, found in recording.read("camera/camera_info", partial(camera_info_lens, is_turned=is_turned)):
        yield found
