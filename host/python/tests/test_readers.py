"""Other packages: PyTorch, NWB, napari. Each test is skipped, with its reason, where the package is not installed."""

import datetime
import os
import subprocess
import sys

import numpy as np
import pytest

import ommatidia

START = datetime.datetime(2026, 3, 1, 9, 30, tzinfo=datetime.timezone.utc)
# 60 frames at 20 Hz; after frame 19 the recording paused for 3 s, after frame 39 one frame is missing.
TIMES = np.arange(60) / 20 + np.where(np.arange(60) > 19, 3.0, 0.0) + np.where(np.arange(60) > 39, 0.05, 0.0)
SUBJECT = {"subject_id": "m1", "species": "Mus musculus", "sex": "F", "age": "P90D"}
ABOUT = {
    "experimenter": ["Doe, Jane"],
    "institution": "Example",
    "lab": "Example",
    "experiment_description": "Synthetic frames",
    "keywords": ["miniscope"],
}


@pytest.fixture
def frames():
    return np.random.default_rng(1).random((60, 18, 22), dtype=np.float32)


def write(path, frames, **options):
    pytest.importorskip("pynwb", reason="pynwb is not installed")
    import ommatidia.nwb

    options = {"session_start_time": START, "timestamps_s": TIMES, "nwbfile": ABOUT, "subject": SUBJECT, **options}
    return ommatidia.nwb.write(path, frames, **options)


def test_nwb_keeps_frames_and_gaps(frames, instrument, tmp_path):
    assert write(tmp_path / "a.nwb", frames, instrument=instrument) == 60
    import pynwb

    with pynwb.NWBHDF5IO(tmp_path / "a.nwb", "r") as io:
        file = io.read()
        series = file.acquisition["OnePhotonSeries"]
        assert np.array_equal(series.data[:], frames)
        assert np.array_equal(series.timestamps[:], TIMES) and series.rate is None
        assert series.imaging_plane.grid_spacing[0] == pytest.approx(2.8e-6)
        assert file.session_start_time == START
    assert os.listdir(tmp_path) == ["a.nwb"]


def test_nwb_of_even_times_has_a_rate_and_streams(frames, tmp_path):
    # A generator: the number of frames is not known before its end.
    assert write(tmp_path / "a.nwb", (frame for frame in frames), timestamps_s=0.5 + np.arange(60) / 20) == 60
    import pynwb

    with pynwb.NWBHDF5IO(tmp_path / "a.nwb", "r") as io:
        series = io.read().acquisition["OnePhotonSeries"]
        assert np.array_equal(series.data[:], frames)
        assert (series.rate, series.starting_time) == (pytest.approx(20.0), 0.5) and series.timestamps is None


@pytest.mark.parametrize("options, words", [
    ({"timestamps_s": TIMES[:-1]}, "one a frame, found 59 for 60"),
    ({"timestamps_s": TIMES[::-1]}, "times that rise"),
    ({"timestamps_s": np.where(TIMES > 1, np.nan, TIMES)}, "finite"),
    ({"timestamps_s": None}, "found neither"),
    ({"rate_hz": 20.0}, "found both"),
    ({"session_start_time": datetime.datetime(2026, 3, 1)}, "time zone"),
])
def test_nwb_refuses_what_is_wrong_and_leaves_no_file(frames, tmp_path, options, words):
    with pytest.raises(ValueError, match=words):
        write(tmp_path / "a.nwb", frames, **options)
    assert os.listdir(tmp_path) == []


def test_nwb_replaces_no_file_unasked(frames, tmp_path):
    write(tmp_path / "a.nwb", frames)
    with pytest.raises(FileExistsError, match="is kept"):
        write(tmp_path / "a.nwb", frames)
    write(tmp_path / "a.nwb", frames, force=True)


def test_nwb_inspector_finds_nothing(frames, instrument, tmp_path):
    inspector = pytest.importorskip("nwbinspector", reason="nwbinspector is not installed")
    write(tmp_path / "a.nwb", frames, instrument=instrument, location="CA1", indicator="GCaMP6f")
    found = [m for m in inspector.inspect_nwbfile(nwbfile_path=str(tmp_path / "a.nwb"))]
    worst = [m for m in found if m.importance.name in ("CRITICAL", "BEST_PRACTICE_VIOLATION", "ERROR")]
    assert not worst, [(m.check_function_name, m.message) for m in worst]


def test_nwb_has_the_miniscope_of_its_extension(frames, tmp_path):
    pytest.importorskip("ndx_miniscope", reason="ndx-miniscope is not installed")
    write(tmp_path / "a.nwb", frames, device={"frameRate": "20FPS", "gain": "low"})
    import pynwb

    with pynwb.NWBHDF5IO(tmp_path / "a.nwb", "r") as io:
        scope = io.read().devices["Miniscope"]
        assert type(scope).__name__ == "Miniscope" and scope.frameRate == "20FPS"


def test_torch_is_not_needed_until_it_is_used():
    script = "import sys, ommatidia.torch; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script]).returncode == 0


def test_torch_workers_share_the_pairs(lab):
    torch = pytest.importorskip("torch", reason="torch is not installed")
    from ommatidia.torch import IterableDataset

    data = IterableDataset(lab / "lab.instrument", 10, seed=3)
    assert len(data) == 10
    expected = ommatidia.simulate(lab / "lab.instrument", 10, seed=3, noise=True)
    for workers in (0, 2):
        loaded = list(torch.utils.data.DataLoader(data, batch_size=None, num_workers=workers))
        assert len(loaded) == 10
        found = {frame.numpy().tobytes() for frame, _ in loaded}
        assert found == {frame.tobytes() for frame, _ in expected}


@pytest.fixture
def viewer(monkeypatch):
    monkeypatch.setenv("QT_QPA_PLATFORM", "offscreen")
    pytest.importorskip("napari", reason="napari is not installed")
    pytest.importorskip("qtpy", reason="no Qt for Python is installed")
    from napari.components import ViewerModel
    from qtpy.QtWidgets import QApplication

    app = QApplication.instance() or QApplication([])
    yield ViewerModel()
    app.processEvents()


def wait(widget):
    """Runs the events of the window until the widget's work is done."""
    import time

    from qtpy.QtWidgets import QApplication

    end = time.monotonic() + 120
    while widget.worker is not None and time.monotonic() < end:
        QApplication.processEvents()
        time.sleep(0.01)
    assert widget.worker is None


def test_napari_finds_the_manifest_and_reads_sessions(lab, session, viewer):
    npe2 = pytest.importorskip("npe2", reason="npe2 is not installed")
    manifest = npe2.PluginManifest.from_distribution("ommatidia")
    assert manifest.name == "ommatidia" and len(manifest.contributions.widgets) == 1
    from ommatidia.napari import get_reader

    assert get_reader(str(lab)) is None and get_reader(str(lab / "lab.instrument")) is None
    layers = get_reader(str(lab / "session"))(str(lab / "session"))
    assert [kind for *_, kind in layers] == ["image"] * len(session.stacks)
    frames, meta, _ = layers[-1]
    assert "scene" in meta["name"] and np.array_equal(np.asarray(frames[1]), session.stacks[-1][1])
    for frames, meta, _ in layers:
        viewer.add_image(frames, **meta)
    assert len(viewer.layers) == len(layers)


def test_napari_widget_opens_reconstructs_and_compares(lab, viewer):
    from ommatidia.napari import OmmatidiaWidget

    widget = OmmatidiaWidget(viewer)
    widget.session.setText(str(lab / "session"))
    widget.model.setText(str(lab / "lab.instrument"))
    widget.open_session()
    wait(widget)
    opened = len(viewer.layers)
    scene = viewer.layers[-1]
    viewer.layers.selection.active = scene
    widget.reconstruct()
    wait(widget)
    assert len(viewer.layers) == opened + 1, widget.text.text()
    assert viewer.layers[-1].data.shape == (3, 18, 22)
    widget.residual()
    wait(widget)
    assert "chi2 / pixel" in widget.text.text() and len(viewer.layers) == opened + 2
    widget.model.setText(str(lab / "nothing"))
    widget.residual()
    wait(widget)
    assert "nothing" in widget.text.text() and all(b.isEnabled() for b in widget.buttons)


def test_the_stubs_are_true(tmp_path):
    pytest.importorskip("mypy", reason="mypy is not installed")
    (tmp_path / "mypy.ini").write_text("[mypy]\nignore_missing_imports = True\nfollow_imports = silent\n")
    # Classes that are made when they are first used, and the order of names in the compiled part.
    (tmp_path / "allowed").write_text(r"ommatidia\..*@\d+" + "\nommatidia._core.__all__\n")
    done = subprocess.run(
        [sys.executable, "-m", "mypy.stubtest", "ommatidia", "--mypy-config-file", tmp_path / "mypy.ini",
         "--allowlist", tmp_path / "allowed", "--ignore-unused-allowlist"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stdout + done.stderr
