"""Runs the examples of docs/python.md in order, in an empty folder.

A block `python` is run by Python, one `sh` by the shell with the program on its path, and a `toml` block is written to
the file that its first line names. `python needs=PACKAGE` is skipped where the package is not installed.
"""

import os
import re
import subprocess
from importlib.util import find_spec
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[3] / "docs" / "python.md"
BLOCK = re.compile(r"^```(toml|python|sh)([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    return tmp_path_factory.mktemp("desk"), {}


def blocks():
    if not PAGE.is_file():
        return []
    return [pytest.param(*m.groups(), id=f"line {PAGE.read_text()[: m.start()].count(chr(10)) + 1}") for m in
            BLOCK.finditer(PAGE.read_text())]


def test_there_are_six_examples():
    assert sum(b.values[0] == "python" and not b.values[1].strip() for b in blocks()) >= 6


@pytest.mark.parametrize("language, options, text", blocks())
def test_example(desk, monkeypatch, language, options, text):
    folder, names = desk
    monkeypatch.chdir(folder)
    needs = re.findall(r"needs=(\w+)", options)
    for package in needs:
        if find_spec(package) is None:
            pytest.skip(f"{package} is not installed")
    if language == "toml":
        Path(text.split("\n")[0].removeprefix("# ")).write_text(text)
    elif language == "sh":
        if "ommatidia" not in text.split()[:1]:
            pytest.skip("how to install: verify has done so")
        program = os.environ.get("OMMATIDIA_PROGRAM")
        if not program:
            pytest.skip("OMMATIDIA_PROGRAM does not name the program")
        path = f"{Path(program).parent}{os.pathsep}{os.environ['PATH']}"
        subprocess.run(["sh", "-e", "-c", text], check=True, env={**os.environ, "PATH": path})
    else:
        if "net.checkpoint" in text and not Path("net.checkpoint").exists():
            pytest.skip("OMMATIDIA_PROGRAM does not name the program that trains net.checkpoint")
        exec(compile(text, str(PAGE), "exec"), names)
