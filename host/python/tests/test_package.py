"""The package by itself: arrays, errors, progress, Ctrl-C, threads, processes."""

import os
import pickle
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest

import ommatidia
from ommatidia import Instrument, Network, OmmatidiaError, Session


def test_a_session_shows_its_stacks_tables_and_frames(session, lab):
    assert [s.role for s in session.stacks][-1] == "scene"
    (bead,) = session.stacks_of("bead")
    assert len(bead) == 25 and bead.table["x_um"].shape == (25,) and np.ptp(bead.table["x_um"]) > 0
    assert bead[0].shape == (50, 70) and bead[0].dtype == np.float32
    assert np.array_equal(bead[-1], bead.frames(24)[0])
    assert bead.truth(0) is None
    assert session.manifest["sensor"]["rows"] == 50 and session.path == lab / "session"
    with pytest.raises(IndexError, match="the stack has 25"):
        bead[25]


def test_errors_have_the_text_of_the_program(lab, instrument, session):
    with pytest.raises(OmmatidiaError, match="missing.instrument"):
        Instrument.load(lab / "missing.instrument")
    with pytest.raises(OmmatidiaError, match="a checkpoint, a network file .blob. or an instrument"):
        Network.load(lab / "session" / "session.toml")
    with pytest.raises(OmmatidiaError, match="expected a finite value >= 0"):
        instrument.predict(np.full(instrument.object_shape, np.nan, np.float32))
    with pytest.raises(OmmatidiaError):
        instrument.predict(np.zeros((3, 3), np.float32))
    with pytest.raises(OmmatidiaError, match="method: expected one of"):
        Network.load(lab / "lab.instrument", method="magic")
    with pytest.raises(OmmatidiaError, match="from the centre"):
        instrument.psf(1e5, 0.0)
    with pytest.raises(ValueError, match="rows, cols"):
        instrument.predict(np.zeros(5, np.float32))
    with pytest.raises(ValueError, match="rows, cols"):
        instrument.predict(np.zeros((0, 18, 22), np.float32))


def test_no_output_replaces_an_input_or_a_file_that_exists(lab, session, tmp_path):
    found = Instrument.load(lab / "lab.instrument")
    before = (lab / "lab.instrument").read_bytes()
    with pytest.raises(OmmatidiaError, match="is an input of the command"):
        found.save(lab / "lab.instrument", force=True)
    found.save(tmp_path / "copy.instrument")
    point = np.eye(18, 22, dtype=np.float32)
    assert np.array_equal(Instrument.load(tmp_path / "copy.instrument").predict(point), found.predict(point))
    with pytest.raises(OmmatidiaError, match="exists already and is kept"):
        Instrument.load(lab / "lab.instrument").save(tmp_path / "copy.instrument")
    with pytest.raises(OmmatidiaError, match="is an input of the command|exists already"):
        ommatidia.close(session, lab / "lab.instrument", lab / "lab.instrument")
    assert (lab / "lab.instrument").read_bytes() == before


def test_arrays_of_any_layout_and_type_give_the_same(instrument, objects):
    whole = instrument.predict(objects)
    assert whole.shape == (3, 50, 70) and whole.dtype == np.float32
    for i, one in enumerate(objects):
        assert np.array_equal(instrument.predict(one), whole[i])
    assert np.array_equal(instrument.predict(np.asfortranarray(objects)), whole)
    assert np.array_equal(instrument.predict(objects[:, ::-1, ::-1][:, ::-1, ::-1]), whole)
    assert np.array_equal(instrument.predict(objects.astype(np.float64)), whole)
    frames = np.round(whole).astype(np.uint16)
    assert np.array_equal(instrument.adjoint(frames), instrument.adjoint(frames.astype(np.float32)))
    # The array is that of the library, not a copy of it.
    assert not instrument.predict(objects[0]).flags.owndata


def test_predictions_take_the_options_of_the_program(instrument, objects):
    plain, black = instrument.predict(objects[0]), instrument.predict(0 * objects[0])
    half = instrument.predict(objects[0], illumination=0.5)
    assert np.allclose(half - black, 0.5 * (plain - black), atol=1e-2)
    noisy = instrument.predict(objects[0], noise=True, seed=3)
    assert np.array_equal(noisy, np.round(noisy))
    assert np.array_equal(noisy, instrument.predict(objects[0], noise=True, seed=3))
    assert not np.array_equal(noisy, instrument.predict(objects[0], noise=True, seed=4))
    with pytest.warns(UserWarning, match="clip at full scale"):
        instrument.predict(objects[0], illumination=1e4)
    with pytest.raises(ValueError, match="found both"):
        instrument.predict(objects[0], depth=0, z_um=0.0)


def test_the_psf_at_a_pixel_is_its_column_of_the_optics(instrument):
    rows, cols = instrument.object_shape
    windows, rays = instrument.psf(0.5 * 2.8, 0.5 * 2.8)
    assert windows.shape[0] == 2 and rays.shape == (2, 2)
    point = np.zeros((rows, cols), np.float32)
    point[rows // 2, cols // 2] = 1.0
    light = instrument._light().forward(point) / instrument.figures["gain_dn_per_e"]
    side = windows.shape[1]
    for window, (r, c) in zip(windows, rays):
        r, c = round(r) - side // 2, round(c) - side // 2
        assert np.abs(window - light[r : r + side, c : c + side]).max() < 1e-3 * light.max()


def test_progress_is_called_here_and_its_exceptions_go_on(session, instrument, objects):
    seen = []
    Instrument.calibrate(session, progress=lambda *step: seen.append((*step, threading.current_thread())))
    names, done, totals, threads = zip(*seen)
    assert set(names) == {"calibrate"} and list(done) == sorted(done) and done[-1] > 25
    assert set(threads) == {threading.main_thread()}

    def refuse(name, done, total):
        raise LookupError(f"{name} {done}")

    with pytest.raises(LookupError, match="calibrate 1"):
        Instrument.calibrate(session, progress=refuse)
    with pytest.raises(LookupError, match="object 1"):
        instrument.predict(objects, progress=refuse)


def test_the_global_lock_is_released(instrument, objects):
    every, done = sys.getswitchinterval(), threading.Event()

    def work():
        for _ in range(100):
            instrument.predict(objects[0])
        done.set()

    # Without this no thread gives the lock away unasked: what gets it has been given it by the work itself.
    sys.setswitchinterval(1000.0)
    try:
        thread = threading.Thread(target=work)
        thread.start()
        first = done.is_set()
    finally:
        sys.setswitchinterval(every)
    thread.join()
    assert not first


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for other processes")
def test_ctrl_c_stops_a_calibration_at_once(tmp_path):
    # The usual virtual instrument, whose frames are computed when they are read: this takes some seconds at least.
    (tmp_path / "usual.toml").write_text("")
    # A program in the background of a shell inherits that interrupts are ignored, and Python keeps to that.
    script = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    script += "import ommatidia; s = ommatidia.Session.open('usual.toml')\n"
    script += "ommatidia.Instrument.calibrate(s, progress=lambda *step: print(*step, flush=True)).save('x')"
    child = subprocess.Popen(
        [sys.executable, "-c", script], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert child.stdout.readline().startswith("calibrate 1")
    child.send_signal(signal.SIGINT)
    _, errors = child.communicate(timeout=60)
    assert child.returncode in (-signal.SIGINT, 130) and "KeyboardInterrupt" in errors, (child.returncode, errors)
    assert not (tmp_path / "x").exists()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*:DeprecationWarning")
def test_a_forked_process_has_threads_of_its_own(instrument, objects):
    expected = instrument.predict(objects)
    child = os.fork()
    if child == 0:
        signal.alarm(120)
        os._exit(0 if np.array_equal(instrument.predict(objects), expected) else 1)
    assert os.waitpid(child, 0)[1] == 0


def test_the_number_of_threads_changes_no_result(instrument, objects):
    expected = instrument.predict(objects)
    ommatidia.set_threads(1)
    try:
        assert np.array_equal(instrument.predict(objects), expected)
    finally:
        ommatidia.set_threads(0)


def test_what_has_a_file_travels_to_other_processes(instrument, session, objects, lab):
    again = pickle.loads(pickle.dumps(instrument))
    assert np.array_equal(again.predict(objects), instrument.predict(objects))
    assert pickle.loads(pickle.dumps(session)).path == session.path
    network = Network.load(lab / "lab.instrument", method="central")
    assert pickle.loads(pickle.dumps(network)).method == "central"
    with pytest.raises(OmmatidiaError, match="save it first"):
        pickle.dumps(Instrument.calibrate(session, replicates=0))


def test_methods_reconstruct_from_an_instrument(session, lab):
    (scenes,) = session.stacks_of("scene")
    network = Network.load(lab / "lab.instrument", method="richardson-lucy")
    found = network.reconstruct(scenes.frames())
    assert found.shape == (3, 18, 22) and (found >= 0).all()
    with pytest.warns(UserWarning, match="frame 0"):
        network.reconstruct(np.full((50, 70), 1e6, np.float32))


def test_simulated_pairs_are_numbered_and_repeat(instrument, lab):
    pairs = ommatidia.simulate(instrument, 5, specimens=["cells"], seed=3)
    assert len(pairs) == 5 and len(list(pairs)) == 5
    frame, truth = pairs[2]
    assert frame.shape == pairs.sensor_shape == (50, 70) and truth.shape == pairs.object_shape
    assert truth.max() == 1.0
    again = ommatidia.simulate(lab / "lab.instrument", 9, specimens=["cells"], seed=3)
    assert np.array_equal(again[2][0], frame)
    noisy = ommatidia.simulate(instrument, 5, specimens=["cells"], seed=3, noise=True)[2][0]
    assert np.array_equal(noisy, np.round(noisy))
    # Noise of a few parts in a thousand of the light, and the black level.
    figures = instrument.figures
    light = (noisy - figures["black_level_dn"]) / figures["gain_dn_per_e"]
    assert abs(light.sum() / frame.sum() - 1) < 0.05
    with pytest.raises(OmmatidiaError, match="specimen: expected one of"):
        ommatidia.simulate(instrument, 5, specimens=["cats"])
    with pytest.raises(OmmatidiaError, match="vary: glare=1"):
        ommatidia.simulate(instrument, 5, vary=["glare=1"])
    hazy = ommatidia.simulate(instrument, 5, specimens=["cells"], seed=3, vary=["background=50"])
    assert 0 < sum(bool((a[0] != b[0]).any()) for a, b in zip(pairs, hazy)) < 5
    with pytest.raises(IndexError):
        pairs[5]


def test_what_was_hidden_is_found_and_closed(lab, session, tmp_path):
    moved = Session.bench(
        tmp_path / "moved", config=lab / "small.toml", effects=["array_shift=0.25"], frames=6, seed=8
    )
    before = ommatidia.residual(moved, lab / "lab.instrument", maps=True)
    assert before["maps"]["residual_sigma"].shape == before["maps"]["measured_dn"].shape
    steps = []
    # The beads of the new session would allow a new calibration; an instrument in memory has no file.
    calibrated = Instrument.calibrate(session)
    result = ommatidia.close(
        moved, calibrated, tmp_path / "closed.instrument", progress=lambda *step: steps.append(step[0])
    )
    assert steps and result["after"]["chi2_ndf"] < result["before"]["chi2_ndf"]
    assert (tmp_path / "closed.closing").is_file() and result["account"] == str(tmp_path / "closed.closing")
    assert [e["id"] for e in Instrument.load(tmp_path / "closed.instrument").effects] or result["effects"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["closed.closing", "closed.instrument", "moved"]
