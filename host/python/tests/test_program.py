"""The package and the program give the same bytes. `OMMATIDIA_PROGRAM` names the program."""

import json
import struct

import numpy as np
import pytest

import ommatidia
from ommatidia import Instrument, Network, Session


@pytest.fixture
def folder(lab, tmp_path, objects, session):
    np.save(tmp_path / "objects.npy", objects)
    np.save(tmp_path / "frames.npy", session.stacks_of("scene")[0].frames())
    return tmp_path


def test_sessions_are_the_same(lab, program, tmp_path):
    program("bench", tmp_path / "session", "--config", lab / "small.toml", "--seed", 7, cwd=lab)
    names = sorted(p.name for p in (lab / "session").iterdir())
    assert sorted(p.name for p in (tmp_path / "session").iterdir()) == names
    for name in names:
        assert (tmp_path / "session" / name).read_bytes() == (lab / "session" / name).read_bytes(), name


def test_calibrations_are_the_same(lab, program, tmp_path):
    printed = program("calibrate", lab / "session", "-o", tmp_path / "a.instrument", cwd=tmp_path)
    found = Instrument.calibrate(lab / "session")
    found.save(tmp_path / "b.instrument")
    assert (tmp_path / "a.instrument").read_bytes() == (tmp_path / "b.instrument").read_bytes()
    for name in ("seconds", "peak_bytes"):
        printed.pop(name)
    assert json.loads(json.dumps(found.figures)) == printed


@pytest.mark.parametrize("options, words", [
    ({}, []),
    ({"noise": True, "seed": 5}, ["--noise", "--seed", 5]),
    ({"illumination": 0.5, "background_e": [8, 4, -2]}, ["--light", 0.5, "--background", "8,4,-2"]),
])
def test_predictions_are_the_same(lab, program, folder, instrument, objects, options, words):
    program("predict", lab / "lab.instrument", "objects.npy", "-o", "out.npy", *words, cwd=folder)
    assert np.array_equal(np.load(folder / "out.npy"), instrument.predict(objects, **options))


def test_transposes_are_the_same(lab, program, folder, instrument):
    program("predict", lab / "lab.instrument", "frames.npy", "-o", "out.npy", "--adjoint", cwd=folder)
    assert np.array_equal(np.load(folder / "out.npy"), instrument.adjoint(np.load(folder / "frames.npy")))


def test_networks_have_the_same_bits_as_float_and_as_network_files(checkpoint, program, folder):
    frames = np.load(folder / "frames.npy")
    printed = program("quantize", checkpoint, "-o", "a.blob", "--name", "net", cwd=folder)
    report = ommatidia.quantize(checkpoint, folder / "b.blob", name="net")
    assert (folder / "a.blob").read_bytes() == (folder / "b.blob").read_bytes()
    assert {**printed, "blob": ""} == {**json.loads(json.dumps(report)), "blob": ""}
    for file, method in ((checkpoint, "svfouriernet"), (folder / "a.blob", "svfouriernet-blob")):
        network = Network.load(file)
        assert network.method == method
        program("reconstruct", "frames.npy", "-o", "out.npy", "--with", file, "--force", cwd=folder)
        assert np.array_equal(np.load(folder / "out.npy"), network.reconstruct(frames)), method


def test_pairs_are_the_same(lab, program, folder, instrument):
    program("simulate", lab / "lab.instrument", "-o", "pairs", "--count", 3, "--seed", 5, cwd=folder)
    bytes_ = (folder / "pairs" / "shard-00000.safetensors").read_bytes()
    (length,) = struct.unpack("<Q", bytes_[:8])
    header, data = json.loads(bytes_[8 : 8 + length]), bytes_[8 + length :]

    def tensor(name):
        start, end = header[name]["data_offsets"]
        return np.frombuffer(data[start:end], np.float32).reshape(header[name]["shape"])

    for i, (frame, truth) in enumerate(ommatidia.simulate(instrument, 3, seed=5)):
        assert np.array_equal(tensor("frames_e")[i], frame) and np.array_equal(tensor("objects")[i], truth)


def test_residual_and_close_say_the_same(lab, program, tmp_path):
    moved = Session.bench(
        tmp_path / "moved", config=lab / "small.toml", effects=["array_shift=0.25"], frames=6, seed=8
    )
    file = lab / "lab.instrument"
    printed = program("residual", tmp_path / "moved", "--instrument", file, cwd=tmp_path)
    assert json.loads(json.dumps(ommatidia.residual(moved, file))) == printed
    printed = program("close", tmp_path / "moved", "--instrument", file, "-o", "a.instrument", cwd=tmp_path)
    found = json.loads(json.dumps(ommatidia.close(moved, Instrument.load(file), tmp_path / "b.instrument")))
    for result in (printed, found):
        del result["seconds"], result["account"]
    assert found == printed
    assert (tmp_path / "a.instrument").read_bytes() == (tmp_path / "b.instrument").read_bytes()
