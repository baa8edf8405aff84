"""Tests of the ownership of high voltage."""

from tactile.server.owners import Owners

ME, YOU = 1, 2


def test_what_playback_disarmed_by_itself_belongs_to_nobody() -> None:
    """High voltage would otherwise stay on for a program that was told that it is off."""
    owners = Owners()
    owners.clients.add(ME)
    assert not owners.check(0.0, running=True, armed=True)
    assert owners.clients == {ME}
    assert not owners.check(0.1, running=False, armed=False)
    assert owners.clients == set()


def test_a_bus_that_arms_again_by_itself_runs_on_for_its_owners() -> None:
    owners = Owners()
    owners.clients.add(ME)
    owners.check(0.0, running=True, armed=False)
    assert owners.clients == {ME}


def test_who_arms_at_present_is_an_owner_before_it_runs() -> None:
    owners = Owners()
    with owners.arm():
        owners.clients.add(ME)
        with owners.arm():
            owners.clients.add(YOU)
        owners.check(0.0, running=False, armed=False)
        assert owners.clients == {ME, YOU}
    owners.check(0.0, running=False, armed=False)
    assert owners.clients == set()


def test_what_belongs_to_nobody_is_told_once_each_time_that_it_lasts() -> None:
    owners = Owners()
    step = 0.5 / 8  # of half a second; a power of two, so that nothing is rounded
    told = [owners.check(k * step, running=True, armed=True) for k in range(20)]
    assert [k for k, one in enumerate(told) if one] == [9, 18]
    assert not owners.check(20 * step, running=True, armed=False)
