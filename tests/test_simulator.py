"""A simulated server keeps its promises, whatever fails and whoever dies.

``TACTILE_LONG=1 pytest tests/test_simulator.py -m ci -s`` simulates an hour, from seeds of the
moment or from ``TACTILE_SEED`` on, and prints them; ``python tests/simulator.py SEED SECONDS`` goes
the same way again.
"""

import os
import time

import pytest
from repeating import LONG
from simulator import Simulation, simulate

FIRST = int(os.environ.get("TACTILE_SEED", time.time_ns() % 2**31)) if LONG else 0


def judged(seed: int, seconds: float) -> Simulation:
    done = simulate(seed, seconds)
    history = "\n".join(done.log[-12:])
    again = f"python tests/simulator.py {seed} {seconds:g}"
    assert not done.wrong, f"{again}\n{history}\n{done.wrong}"
    assert done.sounding, "nothing was played"
    assert done.exact, "nothing was played as it was written"
    return done


def test_promises_hold_whatever_fails() -> None:
    judged(2, 2.0)


@pytest.mark.parametrize("seconds", [0.5, pytest.param(3.0, marks=pytest.mark.ci)])
def test_a_seed_goes_the_same_way_again(seconds: float) -> None:
    first, second = (simulate(9, seconds) for _ in range(2))
    assert first.log == second.log
    assert first.digest.hexdigest() == second.digest.hexdigest()
    assert simulate(10, 0.2).log[:1] != first.log[:1]


@pytest.mark.ci
@pytest.mark.parametrize("seed", range(2, 10))
def test_promises_hold_from_many_seeds(seed: int) -> None:
    begun = time.perf_counter()
    done = judged(FIRST + seed, 450.0 if LONG else 10.0)
    took = time.perf_counter() - begun
    print(f"seed {done.seed}: {done.counts} in {took:.0f} s; to 0 V at worst {done.worst} s")
