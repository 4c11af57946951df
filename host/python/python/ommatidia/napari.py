"""napari: a reader of sessions, and a dock widget that opens, reconstructs and compares, by the public API alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from . import Instrument, Network, Session, residual

_MANIFEST = "session.toml"


def get_reader(path):
    """The reader of a session's folder; None for anything else."""
    if isinstance(path, (list, tuple)):
        path = path[0] if len(path) == 1 else None
    if path is None or not (Path(path) / _MANIFEST).is_file():
        return None
    return read


def read(path):
    """The stacks of a session as layers. Frames are read when they are shown."""
    path = path[0] if isinstance(path, (list, tuple)) else path
    session = Session.open(path)
    saturation = 2.0 ** session.manifest["sensor"]["bit_depth"] - 1.0
    layers = []
    for stack in session.stacks:
        frames = _lazy(stack)
        meta = {
            "name": f"{session.name}: {stack.role} {stack.path.stem}",
            "contrast_limits": (0.0, float(np.clip(np.max(stack[0]), 1.0, saturation))),
            "metadata": {"session": str(session.path), "role": stack.role, "time_s": stack.table["time_s"]},
            "visible": stack.role == "scene",
        }
        layers.append((frames, meta, "image"))
    return layers


def _lazy(stack):
    import dask.array as da
    from dask import delayed

    first = stack[0]
    read_one = delayed(stack.__getitem__, pure=True, name=False)
    return da.stack([da.from_delayed(read_one(i), first.shape, first.dtype) for i in range(len(stack))])


def __getattr__(name):
    if name != "OmmatidiaWidget":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = made = _make_widget()
    return made


def _make_widget():
    from napari.qt.threading import create_worker
    from qtpy import QtWidgets

    class OmmatidiaWidget(QtWidgets.QWidget):
        """Open a session, reconstruct the frames of the selected layer, compare a session with an instrument."""

        def __init__(self, napari_viewer):
            super().__init__()
            self.viewer, self.worker = napari_viewer, None
            self.session = self._place("Session", folder=True)
            self.model = self._place("Network, network file or instrument", folder=False)
            self.bar, self.text = QtWidgets.QProgressBar(), QtWidgets.QLabel("")
            self.text.setWordWrap(True)
            self.buttons = [
                self._button("Open session", self.open_session),
                self._button("Reconstruct selected layer", self.reconstruct),
                self._button("Residual", self.residual),
            ]
            self.stop_button = self._button("Stop", self.stop)
            self.stop_button.setEnabled(False)
            layout = QtWidgets.QVBoxLayout()
            for row in (self.session, self.model):
                layout.addWidget(row.label)
                line = QtWidgets.QHBoxLayout()
                line.addWidget(row)
                line.addWidget(row.browse)
                layout.addLayout(line)
            for widget in (*self.buttons, self.bar, self.stop_button, self.text):
                layout.addWidget(widget)
            layout.addStretch()
            self.setLayout(layout)

        def _place(self, label, folder):
            line = QtWidgets.QLineEdit()
            line.label, line.browse = QtWidgets.QLabel(label), QtWidgets.QPushButton("...")

            def choose():
                dialog = QtWidgets.QFileDialog
                found = dialog.getExistingDirectory(self) if folder else dialog.getOpenFileName(self)[0]
                if found:
                    line.setText(found)

            line.browse.clicked.connect(choose)
            return line

        def _button(self, text, action):
            button = QtWidgets.QPushButton(text)
            button.clicked.connect(lambda _checked=False: action())
            return button

        def open_session(self):
            """Adds the stacks of the session as layers."""
            path = self.session.text()

            def work():
                yield 0, 0
                return read(path)

            def add(layers):
                for frames, meta, _ in layers:
                    self.viewer.add_image(frames, **meta)
                self.text.setText(f"{len(layers)} stacks")

            self._start(work, add)

        def reconstruct(self):
            """Reconstructs the frames of the selected layer into a new layer."""
            layer = self.viewer.layers.selection.active
            if layer is None:
                self.text.setText("select a layer of frames first")
                return
            path, name = self.model.text(), layer.name
            frames = layer.data if layer.data.ndim == 3 else layer.data[None]

            def work():
                yield 0, 0
                network, objects = Network.load(path), []
                for frame in frames:
                    objects.append(network.reconstruct(np.asarray(frame)))
                    yield len(objects), len(frames)
                return np.stack(objects)

            def add(objects):
                self.viewer.add_image(objects, name=f"{name}: {Path(path).name}")
                self.text.setText(f"{len(objects)} objects")

            self._start(work, add)

        def residual(self):
            """Compares session and instrument, and adds the residual maps as a layer."""
            session, model = self.session.text(), self.model.text()

            def work():
                yield 0, 0
                return residual(session, Instrument.load(model), maps=True)

            def add(found):
                maps = found["maps"]["residual_sigma"]
                if len(maps):
                    self.viewer.add_image(maps, name="residual, sigma", colormap="twilight", contrast_limits=(-5, 5))
                figures = f"chi2 / pixel {found['chi2_ndf']}, NRMSE {found['nrmse']}"
                self.text.setText("\n".join([figures, *found["notes"], *found["warnings"]]))

            self._start(work, add)

        def stop(self):
            """Stops the work at its next frame."""
            if self.worker is not None:
                self.worker.quit()

        def _start(self, work, then):
            if self.worker is not None:
                return

            def run():
                # An error is shown beside the buttons; a worker that raises would end the program without napari.
                try:
                    return (yield from work()), ""
                except Exception as error:
                    return None, str(error)

            self.worker = create_worker(run)
            self.worker.yielded.connect(self._progress)
            self.worker.returned.connect(lambda end: self._end(*end, then))
            self.worker.aborted.connect(lambda: self._end(None, "stopped", then))
            for button in self.buttons:
                button.setEnabled(False)
            self.stop_button.setEnabled(True)
            self.text.setText("")
            self.worker.start()

        def _progress(self, step):
            done, total = step
            self.bar.setRange(0, total)
            self.bar.setValue(done)

        def _end(self, result, text, then):
            self.worker = None
            for button in self.buttons:
                button.setEnabled(True)
            self.stop_button.setEnabled(False)
            self.bar.setRange(0, 1)
            self.text.setText(text)
            if result is not None:
                then(result)

    OmmatidiaWidget.__module__, OmmatidiaWidget.__qualname__ = __name__, "OmmatidiaWidget"
    return OmmatidiaWidget
