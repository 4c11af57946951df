"""The optics as linear operators: the dot test, and the tests of the libraries themselves where they are installed."""

import numpy as np
import pytest


def test_the_adjoint_is_the_transpose(instrument):
    op = instrument.as_linear_operator()
    rng = np.random.default_rng(1)
    for _ in range(5):
        x = rng.standard_normal(op.shape[1]).astype(np.float32)
        y = rng.standard_normal(op.shape[0]).astype(np.float32)
        forward, back = np.dot(op @ x, y.astype(float)), np.dot(x.astype(float), op.T @ y)
        assert abs(forward - back) < 1e-5 * np.linalg.norm(op @ x) * np.linalg.norm(y)


def test_it_is_linear_and_takes_matrices(instrument):
    op = instrument.as_linear_operator()
    rng = np.random.default_rng(2)
    a, b = rng.standard_normal((2, op.shape[1])).astype(np.float32)
    scale = np.abs(op @ a).max()
    assert np.abs(op @ (2 * a - b) - (2 * (op @ a) - op @ b)).max() < 1e-5 * scale
    both = np.stack([a, b], 1)
    assert np.array_equal(op @ both, np.stack([op @ a, op @ b], 1))
    back = rng.standard_normal((op.shape[0], 2)).astype(np.float32)
    assert np.array_equal(op.H @ back, np.stack([op.H @ back[:, 0], op.H @ back[:, 1]], 1))


def test_it_is_the_light_of_predictions(instrument, objects):
    op = instrument.as_linear_operator()
    black = instrument.predict(0 * objects[0])
    light = (op @ objects[0].ravel()).reshape(op.sensor_shape)
    seen = instrument.predict(objects[0]) - black
    # Predictions have the response of the pixels, too.
    assert np.linalg.norm(seen - light) < 0.05 * np.linalg.norm(light)


def test_scipy_solves_with_it(instrument, objects):
    from scipy.sparse.linalg import lsqr

    op = instrument.as_linear_operator()
    frame = op @ objects[0].ravel()
    found = lsqr(op, frame, iter_lim=30)[0]
    assert np.linalg.norm(op @ found.astype(np.float32) - frame) < 0.05 * np.linalg.norm(frame)


def test_pylops_own_dot_test(instrument):
    pylops = pytest.importorskip("pylops", reason="pylops is not installed")
    op = instrument.as_linear_operator("pylops")
    assert pylops.utils.dottest(op, *op.shape, rtol=1e-4, atol=1e-3, raiseerror=True)
    assert (op @ np.ones(op.dims, np.float32)).shape == op.dimsd


def test_scico_own_adjoint_test(instrument):
    pytest.importorskip("scico", reason="scico is not installed")
    import scico.linop

    op = instrument.as_linear_operator("scico")
    assert scico.linop.valid_adjoint(op, op.T, eps=1e-5)


def test_deepinv_own_adjoint_test(instrument):
    pytest.importorskip("deepinv", reason="deepinv is not installed")
    import torch

    physics = instrument.as_linear_operator("deepinv")
    x = torch.rand((2, 1, *instrument.object_shape))
    assert abs(physics.adjointness_test(x).item()) < 1e-2
    x.requires_grad_(True)
    physics.A(x).sum().backward()
    expected = physics.A_adjoint(torch.ones((2, 1, *instrument.sensor_shape)))
    assert torch.allclose(x.grad, expected, rtol=1e-4)


def test_other_names_are_refused(instrument):
    with pytest.raises(ValueError, match="expected one of scipy, pylops"):
        instrument.as_linear_operator("matlab")
