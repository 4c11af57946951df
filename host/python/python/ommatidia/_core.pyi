# The compiled part; `ommatidia` passes its names on, and its stubs describe them.
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
