from collections.abc import Callable, Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypeAlias, final

from numpy import float32, float64
from numpy.typing import ArrayLike, NDArray

_Path: TypeAlias = str | PathLike[str]
_Progress: TypeAlias = Callable[[str, int, int | None], object] | None
_Session: TypeAlias = Session | _Path
_Instrument: TypeAlias = Instrument | _Path

__version__: str
__all__ = [
    "Instrument",
    "Network",
    "OmmatidiaError",
    "Session",
    "Simulation",
    "Stack",
    "__version__",
    "close",
    "quantize",
    "residual",
    "set_threads",
    "simulate",
]

class OmmatidiaError(Exception):
    """What the program would print as an error: what is wrong, where, and what to do."""

@final
class Session:
    """A measured session: one folder of frames with a manifest."""

    @staticmethod
    def open(path: _Path, *, seed: int = 1) -> Session:
        """Opens and checks the session in a folder, or a virtual one by its configuration (`.toml`)."""
    @staticmethod
    def bench(
        path: _Path,
        *,
        config: _Path | None = None,
        effects: Sequence[str] = ...,
        frames: int | None = None,
        seed: int = 1,
        force: bool = False,
        progress: _Progress = None,
    ) -> Session:
        """Measures a session with the virtual instrument into a folder, as the verb `bench`, and opens it."""
    @property
    def path(self) -> Path: ...
    @property
    def name(self) -> str: ...
    @property
    def manifest(self) -> dict[str, Any]: ...
    @property
    def stacks(self) -> list[Stack]: ...
    def stacks_of(self, role: Literal["dark", "flat", "bead", "scene"]) -> list[Stack]: ...

@final
class Stack:
    """One stack of a session: frames with the same role."""

    @property
    def role(self) -> str: ...
    @property
    def path(self) -> Path: ...
    @property
    def table(self) -> dict[str, NDArray[float64]]:
        """A column by its name: x_um, y_um, z_um, exposure_ms, illumination, time_s, temperature_c."""
    def frames(self, start: int = 0, stop: int | None = None) -> NDArray[float32]:
        """Frames, DN, [n, sensor rows, sensor cols]."""
    def truth(self, frame: int) -> NDArray[float32] | None:
        """The known object of a frame, [object rows, object cols]."""
    def __len__(self) -> int: ...
    def __getitem__(self, i: int, /) -> NDArray[float32]: ...

@final
class Instrument:
    """The calibrated model of an instrument."""

    @staticmethod
    def calibrate(
        session: _Session,
        *,
        rank: int | None = None,
        max_rank: int | None = None,
        window_px: int | None = None,
        one_psf: bool = False,
        replicates: int | None = None,
        normalise_beads: bool | None = None,
        accept: bool = False,
        gain_dn_per_e: float | None = None,
        read_noise_e: float | None = None,
        seed: int = 1,
        progress: _Progress = None,
    ) -> Instrument:
        """Calibrates the instrument of a session."""
    @staticmethod
    def load(path: _Path) -> Instrument:
        """Reads an instrument file."""
    def save(self, path: _Path, *, force: bool = False) -> None:
        """Writes the instrument. A file that exists is kept unless `force`."""
    @property
    def path(self) -> Path | None: ...
    @property
    def figures(self) -> dict[str, Any]: ...
    @property
    def notes(self) -> list[str]: ...
    @property
    def provenance(self) -> dict[str, Any]: ...
    @property
    def manifest(self) -> dict[str, Any]: ...
    @property
    def effects(self) -> list[dict[str, Any]]: ...
    @property
    def depths_um(self) -> list[float]: ...
    @property
    def object_shape(self) -> tuple[int, int]: ...
    @property
    def sensor_shape(self) -> tuple[int, int]: ...
    def predict(
        self,
        objects: ArrayLike,
        *,
        noise: bool = False,
        exposure_ms: float | None = None,
        illumination: float = 1.0,
        background_e: Sequence[float] = ...,
        depth: int | None = None,
        z_um: float | None = None,
        seed: int = 1,
        progress: _Progress = None,
    ) -> NDArray[float32]:
        """Frames, DN, for objects: [rows, cols] or [n, rows, cols]."""
    def adjoint(
        self,
        frames: ArrayLike,
        *,
        depth: int | None = None,
        z_um: float | None = None,
        progress: _Progress = None,
    ) -> NDArray[float32]:
        """The exact transpose of the optics: frames, DN above black, back to the object grid."""
    def psf(
        self,
        y_um: float,
        x_um: float,
        *,
        depth: int | None = None,
        z_um: float | None = None,
        window_px: int | None = None,
    ) -> tuple[NDArray[float32], NDArray[float64]]:
        """Windows [lens, row, col], e- of unit light, and their chief rays [lens, (row, col)], px."""
    def as_linear_operator(
        self,
        library: Literal["scipy", "pylops", "scico", "deepinv"] = "scipy",
        *,
        depth: int | None = None,
        z_um: float | None = None,
    ) -> Any:
        """The optics as a linear operator of another library."""

@final
class Network:
    """A trained network, or another method of reconstruction, from a file."""

    @staticmethod
    def load(path: _Path, method: str | None = None, seed: int = 1) -> Network:
        """Opens a checkpoint, a network file, or an instrument."""
    @property
    def method(self) -> str: ...
    @property
    def path(self) -> Path: ...
    def reconstruct(self, frames: ArrayLike, *, progress: _Progress = None) -> NDArray[float32]:
        """Objects from raw frames, DN: [rows, cols] or [n, rows, cols]."""

@final
class Simulation:
    """Pairs (frame, object), each simulated when it is asked for."""

    @property
    def object_shape(self) -> tuple[int, int]: ...
    @property
    def sensor_shape(self) -> tuple[int, int]: ...
    def __len__(self) -> int: ...
    def __getitem__(self, i: int, /) -> tuple[NDArray[float32], NDArray[float32]]: ...
    def __iter__(self) -> Iterator[tuple[NDArray[float32], NDArray[float32]]]: ...

def simulate(
    instrument: _Instrument,
    count: int,
    *,
    specimens: Sequence[str] = ...,
    images: _Path | None = None,
    video_frames: int = 1,
    peak_e: Sequence[float] | None = None,
    vary: Sequence[str] = ...,
    noise: bool = False,
    seed: int = 1,
) -> Simulation:
    """Plans training pairs of an instrument: those that the verb `simulate` writes."""

def residual(session: _Session, instrument: _Instrument, *, maps: bool = False, seed: int = 1) -> dict[str, Any]:
    """Compares an instrument with a session: what `residual --json` prints, and `maps` where asked for."""

def close(
    session: _Session,
    instrument: _Instrument,
    output: _Path,
    *,
    plan: bool = False,
    normalise_beads: bool | None = None,
    force: bool = False,
    seed: int = 1,
    progress: _Progress = None,
) -> dict[str, Any]:
    """Finds what an instrument lacks and writes the closed one: what `close --json` prints."""

def quantize(
    checkpoint: _Path,
    output: _Path,
    *,
    name: str | None = None,
    flash_bytes: int | None = None,
    ram_bytes: int | None = None,
    prune: float | None = None,
    tile: int | None = None,
    energy: float | None = None,
    integers: bool = False,
    force: bool = False,
) -> dict[str, Any]:
    """Converts a checkpoint into the network file of a device: what `quantize --json` prints.

    `integers`: 3x3 convolutions with weights of 8 bits and features of 16.
    """

def set_threads(count: int) -> None:
    """Sets the number of threads; 0: one a core. No result depends on it."""
