"""The interface between a display and its actuators, whatever kind they are.

A display file names one kind of actuator by a table: `BimorphActuator` is that of ``[bimorph]``. A
new kind is a class with this interface, a table in `tactile.display.tables`, and the function in
`tactile.display.display` that makes one of the other.
"""

from typing import NamedTuple, Protocol

from tactile.actuator.amplifier import Amplifier
from tactile.actuator.finger import FingerLoad
from tactile.arrays import Complex, Floats


class ActuatorResponse(NamedTuple):
    """Response of an actuator under a finger at frequencies (F,).

    Attributes
    ----------
    displacement : (F,) complex array
        Shear displacement of the contactor per volt at the terminals [m/V].
    admittance : (F,) complex array
        Current into the terminals per volt [A/V].
    """

    displacement: Complex
    admittance: Complex


class PlantLike(Protocol):
    """Interface of a simulation of all contactors in time.

    Attributes
    ----------
    delay : int
        Delay of the outputs of `step` against the drive [samples].
    """

    delay: int

    def step(self, drive: Floats) -> tuple[Floats, Floats]:
        """Compute the response to further drive samples.

        Parameters
        ----------
        drive : (S, N) array of float
            Drive of each contactor [V].

        Returns
        -------
        displacement : (S, N) array of float
            Shear displacement of the skin [m].
        current : (S, N) array of float
            Current into each contactor [A].
        """
        ...


class Actuator(Protocol):
    """Interface of the actuator under one contactor."""

    @property
    def capacitance(self) -> float:
        """Capacitance that the amplifier charges with each step [F]; 0 if there is none."""
        ...

    @property
    def largest_travel(self) -> float:
        """Largest travel to a side that the actuator survives without a finger [m]; or infinite."""
        ...

    def response(self, load: FingerLoad, frequency: Floats) -> ActuatorResponse:
        """Compute the response under a finger.

        Parameters
        ----------
        load : FingerLoad
            Load of the finger.
        frequency : (F,) array of float
            Frequencies [Hz].

        Returns
        -------
        ActuatorResponse
            Displacement and admittance at each frequency.
        """
        ...

    def overload(self, voltage: float) -> tuple[float, str]:
        """Tell how far a voltage is from what the actuator withstands.

        Parameters
        ----------
        voltage : float
            Largest voltage at the terminals [V].

        Returns
        -------
        share : float
            Share of what the actuator withstands; above 1 it must not be applied.
        reason : str
            Quantity that exceeds its limit, with both values, for an error message.
        """
        ...

    def size(self, voltage: float) -> tuple[float, float]:
        """Compute the room that the actuator needs in its opening.

        Parameters
        ----------
        voltage : float
            Largest voltage at the terminals [V].

        Returns
        -------
        tuple of float
            Size along the shear direction, travel included, and across it [m].
        """
        ...

    def plant(
        self, load: FingerLoad, sample_rate: float, *, contactors: int, amplifier: Amplifier
    ) -> PlantLike:
        """Create a simulation in time.

        Parameters
        ----------
        load : FingerLoad
            Load of every contactor.
        sample_rate : float
            Sample rate of the drive [Hz].
        contactors : int
            Number of contactors N.
        amplifier : Amplifier
            Amplifier between drive and terminals.

        Returns
        -------
        PlantLike
            Simulation of all contactors.
        """
        ...
