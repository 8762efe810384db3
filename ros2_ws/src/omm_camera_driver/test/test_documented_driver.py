"""The worked example of docs/cameras.md works as it is printed."""

import re
from pathlib import Path

import numpy as np
import pytest

from omm_camera_driver.driver import CameraSettings, Trigger
from omm_camera_driver.worker import CameraWorker

DOCUMENT = Path(__file__).parents[4] / "docs" / "cameras.md"


def test_the_documented_driver_delivers_what_it_is_given(tmp_path: Path, recorder) -> None:  # type: ignore[no-untyped-def]
    cv2 = pytest.importorskip("cv2")
    example = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)[0]
    names: dict[str, type] = {}
    exec(example, names)
    worker = CameraWorker(
        lambda: names["FolderDriver"](str(tmp_path)),
        CameraSettings(trigger=Trigger.SOFTWARE),
        recorder,
    )
    worker.start()
    assert recorder.wait_for(lambda r: bool(r.problems))
    assert "found none" in recorder.problems[0]
    image = np.arange(48, dtype=np.uint8).reshape(6, 8)
    written = cv2.imencode(".png", image)[1]
    (tmp_path / "writing").write_bytes(written.tobytes())
    (tmp_path / "writing").rename(tmp_path / "1.png")
    assert recorder.wait_for(lambda r: bool(r.cameras))
    stamp_ns = worker.request_image().result(timeout=5.0)
    frame, shown = recorder.frames[-1]
    assert frame.exposure_mid_ns == stamp_ns
    np.testing.assert_array_equal(shown, image)
    assert worker.stop()
