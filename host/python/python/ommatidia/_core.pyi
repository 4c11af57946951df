# The compiled part; `ommatidia` passes its names on, and its stubs describe them.
from typing import final

from numpy import float32
from numpy.typing import ArrayLike, NDArray

from . import (
    Instrument as Instrument,
    Network as Network,
    OmmatidiaError as OmmatidiaError,
    Session as Session,
    Simulation as Simulation,
    Stack as Stack,
    close as close,
    quantize as quantize,
    residual as residual,
    set_threads as set_threads,
    simulate as simulate,
)

__version__: str
__all__ = [
    "Instrument",
    "Light",
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

@final
class Light:
    """Light of objects on the sensor, and the exact transpose of that."""

    @property
    def object_shape(self) -> tuple[int, int]: ...
    @property
    def sensor_shape(self) -> tuple[int, int]: ...
    def forward(self, objects: ArrayLike) -> NDArray[float32]: ...
    def adjoint(self, frames: ArrayLike) -> NDArray[float32]: ...
