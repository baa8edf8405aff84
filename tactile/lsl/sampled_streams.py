"""The streams of one display that hold samples: the finger, the shear and the drive."""

from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np

from tactile.arrays import Floats, Singles
from tactile.client import DisplayInfo
from tactile.client.wire import CommandedSamples
from tactile.lsl.decimation import Decimator
from tactile.lsl.outlets import (
    Outlet,
    OutletDescription,
    describe_contactors,
    describe_contacts,
)
from tactile.lsl.timing import LslClock


class SampleForm(NamedTuple):
    """Form of samples, which decides what streams there are.

    Attributes
    ----------
    sample_rate : float
        Nominal rate of the samples [Hz].
    block_samples : int
        Number of samples of a block.
    has_samples : bool
        Whether there are shear and drive; a link that takes spectrum frames has none.
    """

    sample_rate: float
    block_samples: int
    has_samples: bool


class SampledStreams:
    """Outlets of what a display does, for one sample rate and length of blocks.

    Parameters
    ----------
    info : DisplayInfo
        Display.
    form : SampleForm
        Rate and blocks of the samples.
    streams : collection of str
        Quantities that are offered, as far as the link has them.
    decimate : int
        Factor by which the rate of the drive is divided.
    clock : LslClock
        Clock of LSL.

    Attributes
    ----------
    form : SampleForm
        Rate and blocks of the samples.
    outlets : dict of str to Outlet
        Outlets by quantity.
    """

    def __init__(
        self,
        info: DisplayInfo,
        form: SampleForm,
        streams: Collection[str],
        decimate: int,
        clock: LslClock,
    ) -> None:
        self.form, self._clock = form, clock
        self._decimator = None
        if decimate > 1 and form.has_samples:
            self._decimator = Decimator(decimate, form.sample_rate, len(info.contactors))
        self.outlets = {
            one.quantity: Outlet(one)
            for one in self._describe(info, decimate)
            if one.quantity in streams
        }

    def _describe(self, info: DisplayInfo, decimate: int) -> Iterator[OutletDescription]:
        """Describe all streams that there may be."""
        rate = self.form.sample_rate
        yield describe_contacts(info.name, rate / self.form.block_samples)
        if self.form.has_samples:
            lag = 0.0 if self._decimator is None else self._decimator.half_length / rate
            yield describe_contactors(info.name, "shear", rate, info.contactors)
            yield describe_contactors(info.name, "drive", rate / decimate, info.contactors, lag)

    def push(self, samples: CommandedSamples) -> None:
        """Add samples to all streams.

        Parameters
        ----------
        samples : CommandedSamples
            Samples of at least one block.
        """
        times = self._clock.to_lsl(np.array(samples.times))
        within = np.arange(samples.block_samples) / samples.sample_rate
        sample_times = (times[:, None] + within).ravel()
        if "contacts" in self.outlets:
            finger_times = self._clock.to_lsl(np.array(samples.finger_times))
            self.outlets["contacts"].push(finger_times, _contacts(samples))
        if "shear" in self.outlets and samples.shear is not None:
            self.outlets["shear"].push(sample_times, 1e6 * _rows(samples.shear))
        if "drive" in self.outlets and samples.drive is not None:
            self._push_drive(samples.first, sample_times, _rows(samples.drive))

    def _push_drive(self, first: int, times: Floats, drive: Singles) -> None:
        """Add the drive, decimated if that was asked for."""
        outlet = self.outlets["drive"]
        if self._decimator is None:
            outlet.push(times, drive)
        else:
            outlet.push(*self._decimator.push(first, times, drive))

    def close(self) -> None:
        """Withdraw the streams."""
        for outlet in self.outlets.values():
            outlet.close()


def _rows(values: "memoryview[float]") -> Singles:
    """Return samples as an array."""
    return np.asarray(values, np.float32)


def _contacts(samples: CommandedSamples) -> Floats:
    """Return the channels of the finger for each block (B, 6), in the units of the stream."""
    return np.column_stack(
        (
            1e3 * np.array(samples.position),
            1e3 * np.array(samples.velocity),
            np.array(samples.normal_force),
            np.array(samples.touching),
        )
    )
