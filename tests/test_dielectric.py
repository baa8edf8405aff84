"""The causal dielectric, against Kramers–Kronig relations and the constant-phase element."""

import numpy as np
import pytest

from tactile.actuator.dielectric import debye_chain


@pytest.mark.parametrize("loss_tangent", [0.002, 0.02, 0.05])
def test_loss_tangent_is_constant_over_the_band(loss_tangent: float) -> None:
    """The ratio tan δ is within 1 % of the stated one from 1 Hz to 10 kHz."""
    relative = debye_chain(loss_tangent).at(np.geomspace(1, 10e3, 1000))
    assert -relative.imag / relative.real == pytest.approx(np.full(1000, loss_tangent), rel=0.01)


def test_permittivity_falls_as_that_of_the_constant_phase_element() -> None:
    """ε' ∝ f^(−2δ/π), 2.9 % per decade at 0.02: from 3 Hz to 3 kHz to 2e-3 of ε'."""
    frequency = np.geomspace(3, 3e3, 7)
    expected = (frequency / 1e3) ** (-2 * np.arctan(0.02) / np.pi)
    assert debye_chain(0.02).at(frequency).real == pytest.approx(expected, rel=2e-3)
    assert 1 - expected[-1] / (expected[-1] * 10 ** (2 * 0.02 / np.pi)) == pytest.approx(
        0.029, abs=5e-4
    )


@pytest.mark.parametrize("at", [10.0, 100.0, 1000.0])
def test_kramers_kronig_relations_hold(at: float) -> None:
    """ε'(ω) − ε'(∞) = (2/π) P∫ x ε''(x)/(x² − ω²) dx, integrated on a grid of 60 decades, to 1e-5.

    The principal value is taken by subtracting ω ε''(ω)/(x² − ω²), whose own integral is zero.
    """
    chain = debye_chain(0.02)
    logarithm = np.linspace(np.log(1e-7), np.log(1e11), 400_001)
    x = at * np.exp(logarithm - logarithm[200_000] + 1e-7)
    loss, own = -chain.at(x).imag, -chain.at(at).imag
    integrand = (x * loss - at * own) / (x**2 - at**2) * x
    real = 2 / np.pi * np.trapezoid(integrand, logarithm)
    assert chain.instantaneous + real == pytest.approx(float(chain.at(at).real), abs=1e-5)


def test_without_loss_there_is_no_relaxation() -> None:
    chain = debye_chain(0.0)
    assert chain.at([1.0, 1e4]).tolist() == [1, 1]
    assert len(chain.rate) == 0
