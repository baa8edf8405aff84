"""The bimorph as the actuator of a display."""

from dataclasses import dataclass

import numpy as np

from tactile.actuator.actuator import ActuatorResponse
from tactile.actuator.amplifier import Amplifier
from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.actuator.materials import LARGEST_FIELD, LARGEST_STRESS
from tactile.actuator.plant import Plant
from tactile.actuator.resonance import EULER_ROOT
from tactile.actuator.response import tip_response
from tactile.arrays import Floats


@dataclass(frozen=True)
class BimorphActuator:
    """Bender that shears the skin with its tip; an `Actuator`.

    Attributes
    ----------
    bimorph : Bimorph
        Geometry and materials.
    """

    bimorph: Bimorph

    @property
    def capacitance(self) -> float:
        """Capacitance at rest, clamped segment included [F]."""
        r = tip_response(self.bimorph, FingerLoad.none(), [1.0])
        return float((r.admittance / (2j * np.pi * r.frequency)).real[0])

    @property
    def largest_travel(self) -> float:
        """Travel at which the free bender, at its resonance, reaches `LARGEST_STRESS` [m].

        The first mode of a slender cantilever has the curvature λ² x/l² at the clamp, with λ² =
        3.516 and the tip's travel x (any textbook). The outer fibers of the ceramic are there
        strained by half the height times that.
        """
        b = self.bimorph
        strain = LARGEST_STRESS * np.asarray(b.piezo.s11E)
        curvature = strain / (np.asarray(b.height) / 2)
        return float(curvature * np.asarray(b.length) ** 2 / EULER_ROOT**2)

    def response(self, load: FingerLoad, frequency: Floats) -> ActuatorResponse:
        """Compute the response of the tip under a finger.

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
        r = tip_response(self.bimorph, load, frequency)
        return ActuatorResponse(r.displacement, r.admittance)

    def overload(self, voltage: float) -> tuple[float, str]:
        """Compare the field in the piezo layers with the largest that they withstand.

        Parameters
        ----------
        voltage : float
            Largest voltage at the electrodes [V].

        Returns
        -------
        share : float
            Share of `LARGEST_FIELD`.
        reason : str
            Both fields.
        """
        field = voltage * float(self.bimorph.layer_voltage / self.bimorph.piezo_height)
        return field / LARGEST_FIELD, (
            f"{field / 1e3:.0f} V/mm in the piezo layers exceeds {LARGEST_FIELD / 1e3:.0f} V/mm"
        )

    def size(self, voltage: float) -> tuple[float, float]:
        """Compute the room that the bender needs in its opening.

        Parameters
        ----------
        voltage : float
            Largest voltage at the electrodes [V].

        Returns
        -------
        tuple of float
            Height with the travel of the free tip to both sides, and width [m].
        """
        free = tip_response(self.bimorph, FingerLoad.none(), [0.0]).displacement[0]
        travel = voltage * float(np.abs(free))
        return float(self.bimorph.height) + 2 * travel, float(self.bimorph.width)

    def plant(
        self, load: FingerLoad, sample_rate: float, *, contactors: int, amplifier: Amplifier
    ) -> Plant:
        """Create the simulation of the benders in time.

        Parameters
        ----------
        load : FingerLoad
            Load of every contactor.
        sample_rate : float
            Sample rate of the drive [Hz].
        contactors : int
            Number of contactors N.
        amplifier : Amplifier
            Amplifier between drive and electrodes.

        Returns
        -------
        Plant
            Modal model of all contactors.
        """
        return Plant(self.bimorph, load, sample_rate, contactors=contactors, amplifier=amplifier)
