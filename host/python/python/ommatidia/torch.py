"""Training pairs for PyTorch. PyTorch is needed when `IterableDataset` is first used, and not before."""

from __future__ import annotations

from . import simulate


def __getattr__(name):
    if name != "IterableDataset":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = made = _make()
    return made


def _make():
    try:
        import torch
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("ommatidia.torch needs PyTorch: `pip install torch`", name="torch") from error

    class IterableDataset(torch.utils.data.IterableDataset):
        """Pairs (frame, object) of an instrument, simulated when they are needed.

        The frame is a float32 tensor [sensor rows, sensor cols], whole DN with noise (or, with `noise=False`, electrons
        without), the object one [object rows, object cols] with maximum 1. `instrument` is an instrument or its file;
        further arguments are those of `ommatidia.simulate`. Workers of a `DataLoader`, and the processes of
        `torch.distributed`, share the pairs: each is given once.
        """

        def __init__(self, instrument, count, *, noise=True, **settings):
            self.instrument, self.count, self.settings = instrument, count, {"noise": noise, **settings}
            group = torch.distributed
            ready = group.is_available() and group.is_initialized()
            # Workers do not know the group, so it is asked here.
            self.process, self.processes = (group.get_rank(), group.get_world_size()) if ready else (0, 1)
            self._simulation = simulate(instrument, count, **self.settings)

        def __len__(self):
            return len(range(self.process, self.count, self.processes))

        def __iter__(self):
            if self._simulation is None:
                self._simulation = simulate(self.instrument, self.count, **self.settings)
            worker = torch.utils.data.get_worker_info()
            number, workers = (worker.id, worker.num_workers) if worker else (0, 1)
            for i in range(self.process + number * self.processes, self.count, self.processes * workers):
                frame, truth = self._simulation[i]
                yield torch.from_numpy(frame), torch.from_numpy(truth)

        def __getstate__(self):
            return {**self.__dict__, "_simulation": None}

    IterableDataset.__module__, IterableDataset.__qualname__ = __name__, "IterableDataset"
    return IterableDataset
