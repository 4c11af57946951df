"""The optics of an instrument as a linear operator of other packages.

The operator maps objects, in the light unit of the instrument, to light on the sensor, DN above black at the exposure
of the calibration, without effects, pixel response, noise and clipping. Its adjoint is the exact transpose.
"""

from __future__ import annotations

import numpy as np


def as_linear_operator(self, library="scipy", *, depth=None, z_um=None):
    """The optics as a linear operator of `library`: "scipy", "pylops", "scico" or "deepinv".

    `depth` is the index of a calibrated depth, `z_um` a depth between them; without both it is the depth nearest to 0.
    """
    if library not in _LIBRARIES:
        raise ValueError(f"library: expected one of {', '.join(_LIBRARIES)}, found {library!r}")
    light = self._light(depth=depth, z_um=z_um)
    try:
        return _LIBRARIES[library](light)
    except ModuleNotFoundError as error:
        remedy = f"this operator needs {error.name}; install it with `pip install {library}`"
        raise ModuleNotFoundError(remedy, name=error.name) from error


def _scipy(light):
    from scipy.sparse.linalg import LinearOperator

    object_shape, sensor_shape = light.object_shape, light.sensor_shape

    class LightOperator(LinearOperator):
        """Vectors are objects and frames whose rows follow each other."""

        def __init__(self):
            self.object_shape, self.sensor_shape = object_shape, sensor_shape
            super().__init__(np.dtype(np.float32), (int(np.prod(sensor_shape)), int(np.prod(object_shape))))

        def _matvec(self, x):
            return light.forward(x.reshape(object_shape)).ravel()

        def _rmatvec(self, y):
            return light.adjoint(y.reshape(sensor_shape)).ravel()

        def _matmat(self, x):
            return light.forward(x.T.reshape(-1, *object_shape)).reshape(x.shape[1], -1).T

        def _rmatmat(self, y):
            return light.adjoint(y.T.reshape(-1, *sensor_shape)).reshape(y.shape[1], -1).T

    return LightOperator()


def _pylops(light):
    import pylops

    op = _scipy(light)
    return pylops.LinearOperator(Op=op, dims=light.object_shape, dimsd=light.sensor_shape)


def _scico(light):
    import jax
    import scico.linop

    def outside(apply, shape):
        result = jax.ShapeDtypeStruct(shape, np.float32)
        return lambda x: jax.pure_callback(lambda v: apply(np.asarray(v)), result, x)

    return scico.linop.LinearOperator(
        input_shape=light.object_shape,
        output_shape=light.sensor_shape,
        eval_fn=outside(light.forward, light.sensor_shape),
        adj_fn=outside(light.adjoint, light.object_shape),
        input_dtype=np.float32,
        output_dtype=np.float32,
        jit=False,
    )


def _deepinv(light):
    import deepinv
    import torch

    def outside(apply):
        def of(x, **_):
            # [batch, 1, rows, cols], as deepinv has images.
            array = apply(x.detach().cpu().numpy()[:, 0])
            return torch.from_numpy(array)[:, None].to(x.device)

        return of

    forward, adjoint = outside(light.forward), outside(light.adjoint)

    class Map(torch.autograd.Function):
        """A linear map with its transpose as gradient."""

        @staticmethod
        def forward(ctx, x, there, back):
            ctx.there, ctx.back = there, back
            return there(x)

        @staticmethod
        def backward(ctx, gradient):
            return Map.apply(gradient, ctx.back, ctx.there), None, None

    return deepinv.physics.LinearPhysics(
        A=lambda x, **_: Map.apply(x, forward, adjoint),
        A_adjoint=lambda y, **_: Map.apply(y, adjoint, forward),
        img_size=(1, *light.object_shape),
    )


_LIBRARIES = {"scipy": _scipy, "pylops": _pylops, "scico": _scico, "deepinv": _deepinv}
