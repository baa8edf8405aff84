"""Reading of a display file into the arrays that the renderer needs.

The TOML file states where each contactor stands, in which direction it shears, which channel drives
it, which bender, finger and amplifier it has, and which limits must never be exceeded. Contactors
are given as a ``[grid]`` or one by one as ``[[contactor]]``. A measured response of amplifier and
loaded bimorph may replace the model for some or all of them. All quantities in `Display` are in SI
units. Contactors and channels are counted from 0.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tactile import files
from tactile.actuator.actuator import Actuator
from tactile.actuator.amplifier import Amplifier
from tactile.actuator.benders import BENDERS
from tactile.actuator.bimorph import Bimorph
from tactile.actuator.bimorph_actuator import BimorphActuator
from tactile.actuator.finger import FingerLoad, FingerTable
from tactile.actuator.materials import (
    PIEZOS,
    SHIMS,
    VACUUM_PERMITTIVITY,
    PiezoMaterial,
    ShimMaterial,
)
from tactile.actuator.voice_coil import VoiceCoil
from tactile.arrays import Complex, Floats
from tactile.display.tables import (
    AmplifierTable,
    BimorphTable,
    Contactor,
    DisplayFile,
    FingerLoadTable,
    LimitsTable,
)
from tactile.errors import InputError

Part = TypeVar("Part", Bimorph, PiezoMaterial, ShimMaterial)

COLUMNS = ("frequency_hz", "magnitude", "phase_deg", "unit")
"""Columns of a file with a measured response."""
UNITS = {"m/V": 1.0, "um/V": 1e-6, "µm/V": 1e-6, "nm/V": 1e-9}
"""Factor to m/V of each unit that a measured response may have."""
MEASURED_BAND = (20.0, 1000.0)
"""Lowest and highest frequency that a measured response must cover [Hz]."""


@dataclass(frozen=True, kw_only=True)
class DriveLimits:
    """Limits that the drive of an amplifier and a bimorph must keep.

    Parameters
    ----------
    voltage : float
        Largest magnitude of the drive [V]; the voltage at the electrodes is larger by the gain of
        the amplifier.
    slew : float
        Largest rate of change of the drive [V/s].
    current : float
        Largest current of one channel into the capacitance of its bimorph [A]; infinite for none.
    fade : float
        Length of the ordinary ramp to or from 0 V [s].

    Raises
    ------
    ValueError
        If a limit is not above zero, or is infinite and not the current.
    """

    voltage: float
    slew: float = 0.7e6
    current: float = np.inf
    fade: float = 20e-3

    def __post_init__(self) -> None:
        for name in ("voltage", "slew", "fade"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"Limits: {name} = {value} is not a finite number above 0")
        if not self.current > 0:
            raise ValueError(f"Limits: current = {self.current} A is not above 0")

    def step(self, sample_rate: float, capacitance: float) -> float:
        """Compute the largest change of drive from one sample to the next.

        Parameters
        ----------
        sample_rate : float
            Sample rate of the drive [Hz].
        capacitance : float
            Capacitance of an actuator times the gain of the amplifier [F]; 0 for none.

        Returns
        -------
        float
            Largest change per sample [V].
        """
        charging = self.current / capacitance if capacitance > 0 else math.inf
        return min(self.slew, charging) / sample_rate


@dataclass(frozen=True)
class MeasuredResponse:
    """Measured response of loaded actuators: shear displacement per volt.

    A response of contactors or of a group is that of amplifier and actuator together, per volt of
    drive. The response of a ``[voice_coil]`` is that of the actuator alone, per volt at its
    terminals, and does not include the amplifier.

    Between the frequencies of the measurement, the logarithm of the magnitude and the unwrapped
    phase are interpolated linearly; beyond its ends both are held constant.

    Attributes
    ----------
    frequency : (K,) array of float
        Frequencies, ascending [Hz].
    magnitude : (K,) array of float
        Magnitude of the response [m/V].
    phase : (K,) array of float
        Phase of the response [rad].
    """

    frequency: Floats
    magnitude: Floats
    phase: Floats

    def at(self, frequency: Floats) -> Complex:
        """Interpolate the response.

        Parameters
        ----------
        frequency : (F,) array of float
            Frequencies [Hz].

        Returns
        -------
        (F,) complex array
            Shear displacement per volt of drive, or per volt at the terminals [m/V].
        """
        size = np.exp(np.interp(frequency, self.frequency, np.log(self.magnitude)))
        turn = np.interp(frequency, self.frequency, np.unwrap(self.phase))
        return np.asarray(size * np.exp(1j * turn))


@dataclass(frozen=True, kw_only=True)
class Display:
    """An array of contactors, with its benders, finger, amplifier and limits.

    Attributes
    ----------
    name : str
        Name of the display.
    contactors : (N, 2) array of float
        Positions of the contactors under the finger [m].
    shear_direction : (N,) array of float
        Shear direction of each contactor, from the x axis [rad].
    polarity : (N,) array of float
        1, or −1 where a positive voltage shears against ``shear_direction``.
    channel : (N,) array of int
        Channel that drives each contactor.
    opening : tuple of float
        Size of an opening along and across the shear direction [m].
    projected : bool
        Whether shear is projected on the direction of motion.
    actuator : Actuator
        Actuator of every contactor.
    load : FingerLoad or FingerTable
        Load of every contactor.
    amplifier : Amplifier
        Amplifier of every channel.
    limits : DriveLimits
        Limits of the drive of every channel.
    measured : tuple of MeasuredResponse
        Measured responses that replace the model.
    kind : (N,) array of int
        Response of each contactor: 0 for the model, k for ``measured[k − 1]``.
    """

    name: str
    contactors: Floats
    shear_direction: Floats
    polarity: Floats
    channel: NDArray[np.intp]
    opening: tuple[float, float]
    projected: bool
    actuator: Actuator
    load: FingerLoad | FingerTable
    amplifier: Amplifier
    limits: DriveLimits
    measured: tuple[MeasuredResponse, ...] = ()
    kind: NDArray[np.intp]

    @property
    def channels(self) -> int:
        """Number of channels of the amplifier, unused ones below the highest included."""
        return int(self.channel.max()) + 1

    @property
    def shear_axes(self) -> Floats:
        """Unit vectors of the shear directions, of shape (N, 2)."""
        return np.stack([np.cos(self.shear_direction), np.sin(self.shear_direction)], axis=1)

    @property
    def bimorph(self) -> Bimorph:
        """Bender of every contactor.

        Raises
        ------
        InputError
            If the display has actuators of another kind.
        """
        if not isinstance(self.actuator, BimorphActuator):
            raise InputError(f"display {self.name!r}: its actuators are not bimorphs")
        return self.actuator.bimorph

    @property
    def capacitance(self) -> float:
        """Capacitance of one actuator at rest, to which the current limit refers [F]."""
        return self.actuator.capacitance

    @property
    def slew(self) -> float:
        """Largest rate of change of the drive that slew limit and current limit allow [V/s]."""
        return self.limits.step(1.0, self.capacitance * self.amplifier.gain)

    @property
    def load_forces(self) -> tuple[float, ...]:
        """Normal forces of the finger's table, or 1 N for a load that does not vary [N]."""
        return self.load.normal_force if isinstance(self.load, FingerTable) else (1.0,)

    def load_at(self, normal_force: float) -> FingerLoad:
        """Return the load of the finger at a normal force.

        Parameters
        ----------
        normal_force : float
            Normal force [N].

        Returns
        -------
        FingerLoad
            Load at that force.
        """
        return self.load.at(normal_force) if isinstance(self.load, FingerTable) else self.load

    def responses(self, frequency: Floats, sample_rate: float) -> Complex:
        """Compute the shear displacement per volt of drive, amplifier included.

        Parameters
        ----------
        frequency : (F,) array of float
            Frequencies [Hz].
        sample_rate : float
            Sample rate of the drive, which matters to an amplifier that holds [Hz].

        Returns
        -------
        (L, C, F) complex array
            Response for each force of ``load_forces`` and each value of ``kind`` [m/V].

        Examples
        --------
        Static displacement of the loaded tip, and that at 250 Hz, in µm/V:

        >>> import numpy as np
        >>> import tactile
        >>> display = tactile.load_display("reference-24")
        >>> response = display.responses(np.array([0.0, 250.0]), 8000.0)
        >>> response.shape
        (1, 1, 2)
        >>> (np.abs(response[0, 0]) * 1e6).round(3).tolist()
        [0.564, 0.529]
        """
        table = []
        for force in self.load_forces:
            model = self.actuator.response(self.load_at(force), frequency)
            volts = self.amplifier.response(frequency, model.admittance, sample_rate)
            table.append([model.displacement * volts, *(m.at(frequency) for m in self.measured)])
        return np.array(table)

    def response_in_air(self, frequency: Floats, sample_rate: float) -> Complex:
        """Compute the displacement of a contactor without a finger per volt of drive.

        It is that of the model, also for contactors whose response under the finger was measured.

        Parameters
        ----------
        frequency : (F,) array of float
            Frequencies [Hz].
        sample_rate : float
            Sample rate of the drive, which matters to an amplifier that holds [Hz].

        Returns
        -------
        (F,) complex array
            Displacement per volt, amplifier included [m/V].

        Examples
        --------
        A free bender swings 51 times as far at its resonance as at rest:

        >>> import numpy as np
        >>> import tactile
        >>> display = tactile.load_display("reference-24")
        >>> size = np.abs(display.response_in_air(np.array([0.0, 930.0]), 8000.0))
        >>> round(float(size[1] / size[0]))
        51
        """
        model = self.actuator.response(FingerLoad.none(), frequency)
        volts = self.amplifier.response(frequency, model.admittance, sample_rate)
        return np.asarray(model.displacement * volts)

    def to_channels(self, drive: Floats) -> Floats:
        """Assign the drive of contactors to channels.

        Parameters
        ----------
        drive : (S, N) array of float
            Drive of each contactor [V].

        Returns
        -------
        (S, channels) array of float
            Drive of each channel; unused channels are at 0 V [V].
        """
        lines = np.zeros((len(drive), self.channels))
        lines[:, self.channel] = drive
        return lines


def load_display(
    name_or_path: str | Path, *, load: FingerLoad | FingerTable | None = None
) -> Display:
    """Load a shipped display by its name, or a display from a file.

    Parameters
    ----------
    name_or_path : str or Path
        Name of a shipped display ("reference-24", "reference-64") or path of a TOML file.
    load : FingerLoad or FingerTable, optional
        Load that replaces the finger of the file.

    Returns
    -------
    Display
        The display.

    Raises
    ------
    NotFoundError
        If there is no such display; the message suggests the nearest name.
    InputError
        If the file is not valid; the message gives file, field, value and limit in one line.

    Examples
    --------
    >>> import tactile
    >>> display = tactile.load_display("reference-24")
    >>> display.channels, display.limits.voltage
    (24, 100.0)
    >>> tactile.load_display("reference-24", load=tactile.FingerLoad.high()).load.k0
    4300.0
    """
    return load_with_source(name_or_path, load=load)[0]


def load_with_source(
    name_or_path: str | Path, *, load: FingerLoad | FingerTable | None = None
) -> tuple[Display, files.SourceFile]:
    """Load a display together with the texts of the files that describe it.

    Parameters
    ----------
    name_or_path : str or Path
        As in `load_display`.
    load : FingerLoad or FingerTable, optional
        As in `load_display`; it is not part of the texts.

    Returns
    -------
    display : Display
        The display.
    source : SourceFile
        Text of the display file, and of the measured responses that it uses.

    Raises
    ------
    NotFoundError, InputError
        As in `load_display`.
    """
    path = files.find("displays", name_or_path)
    source = files.SourceFile(path.name, files.read_text(path), {})

    def read(name: str) -> str:
        source.tables[name] = files.read_table(path.parent / name)
        return source.tables[name]

    return _display(source.text, path, read, load), source


def display_of(source: files.SourceFile, folder: Path) -> Display:
    """Build a display from the texts of its files.

    Parameters
    ----------
    source : SourceFile
        Texts, as `load_with_source` returns them.
    folder : Path
        Folder of the file in error messages; no file is read.

    Returns
    -------
    Display
        The display.

    Raises
    ------
    InputError
        As in `load_display`, or if the text of a measured response is missing.
    """
    path = folder / source.name

    def read(name: str) -> str:
        if name not in source.tables:
            raise InputError(f"{path}: the text of {name!r} is missing")
        return source.tables[name]

    return _display(source.text, path, read, None)


def _display(
    text: str, path: Path, read: Callable[[str], str], load: FingerLoad | FingerTable | None
) -> Display:
    """Return the display that a text describes; `read` returns the text of a table by its name."""
    content = files.parse(text, path, DisplayFile)

    def response(name: str) -> MeasuredResponse:
        return _response(read(name), path.parent / name)

    try:
        display = _build(content, response, load)
        _check_geometry(display)
    except InputError as error:
        if str(error).startswith(str(path.parent)):
            raise
        raise InputError(f"{path}: {error}") from error
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    return display


def _build(
    content: DisplayFile,
    response: Callable[[str], MeasuredResponse],
    load: FingerLoad | FingerTable | None,
) -> Display:
    """Return the display that a file describes."""
    contactors = contactors_of(content)
    measured, kind = _measured(content, contactors, response)
    return Display(
        name=content.display.id,
        contactors=np.array([c.position_mm for c in contactors]) * 1e-3,
        shear_direction=np.radians([c.shear_direction_deg for c in contactors]),
        polarity=np.array([c.polarity for c in contactors], np.float64),
        channel=np.array([c.channel for c in contactors], np.intp),
        opening=(content.display.opening_mm[0] * 1e-3, content.display.opening_mm[1] * 1e-3),
        projected=content.display.shear_projection == "motion",
        actuator=_actuator(content, response),
        load=_load(content.finger) if load is None else load,
        amplifier=_amplifier(content.amplifier),
        limits=_limits(content.limits),
        measured=measured,
        kind=kind,
    )


def contactors_of(content: DisplayFile) -> tuple[Contactor, ...]:
    """List the contactors of a display file; those of a grid are expanded.

    Parameters
    ----------
    content : DisplayFile
        Content of the file.

    Returns
    -------
    tuple of Contactor
        Contactors in the order of their numbers.
    """
    if content.grid is None:
        return content.contactor
    g = content.grid
    x = (np.arange(g.columns) - (g.columns - 1) / 2) * g.pitch_mm[0]
    y = (np.arange(g.rows) - (g.rows - 1) / 2) * g.pitch_mm[1]
    return tuple(
        Contactor(
            position_mm=(float(x[i % g.columns]), float(y[i // g.columns])),
            channel=g.first_channel + i,
            shear_direction_deg=g.shear_direction_deg,
            polarity=g.polarity,
        )
        for i in range(g.columns * g.rows)
    )


def _actuator(content: DisplayFile, response: Callable[[str], MeasuredResponse]) -> Actuator:
    coil = content.voice_coil
    if coil is None:
        return BimorphActuator(_bimorph(content.bimorph or BimorphTable()))
    return VoiceCoil(
        measured=response(coil.response).at,
        resistance=coil.resistance_ohm,
        inductance=coil.inductance_mh * 1e-3,
        largest_current=min(coil.current_a, _limits(content.limits).current),
        room=(coil.size_mm[0] * 1e-3, coil.size_mm[1] * 1e-3),
    )


def _bimorph(table: BimorphTable) -> Bimorph:
    """Return the bender that a table describes."""
    for key, known in (("bender", BENDERS), ("piezo", PIEZOS), ("shim", SHIMS)):
        name = getattr(table, key)
        if name is not None and name not in known:
            raise InputError(f"bimorph.{key} = {name!r}: unknown; {files.nearest(name, [*known])}")
    base = Bimorph() if table.bender is None else BENDERS[table.bender]
    piezo = _adjusted(
        base.piezo if table.piezo is None else PIEZOS[table.piezo],
        s11E=_in_si(table.s11e_um2_per_n, 1e-12),
        d31=_in_si(table.d31_pm_per_v, 1e-12),
        eps33T=_in_si(table.eps33t_relative, VACUUM_PERMITTIVITY),
        quality_factor=table.piezo_quality,
        loss_tangent=table.loss_tangent,
    )
    shim = base.shim if table.shim is None else SHIMS[table.shim]
    return _adjusted(
        base,
        width=_in_si(table.width_mm, 1e-3),
        length=_in_si(table.length_mm, 1e-3),
        clamped_length=_in_si(table.clamped_length_mm, 1e-3),
        piezo_height=_in_si(table.piezo_height_mm, 1e-3),
        shim_height=_in_si(table.shim_height_mm, 1e-3),
        piezo=piezo,
        shim=_adjusted(shim, quality_factor=table.shim_quality),
        layer_stiffening=table.layer_stiffening,
        series=None if table.wiring is None else table.wiring == "series",
    )


def _in_si(value: float | None, unit: float) -> float | None:
    """Return a value in SI units, or None for None."""
    return None if value is None else value * unit


def _adjusted(part: Part, **values: Any) -> Part:
    """Return a bender or a material with values replaced; None leaves a value unchanged."""
    return replace(part, **{k: v for k, v in values.items() if v is not None})


def _load(finger: FingerLoadTable) -> FingerLoad | FingerTable:
    """Return the load that a table describes."""
    if finger.preset is not None:
        return getattr(FingerLoad, finger.preset)()  # type: ignore[no-any-return]
    if finger.table:
        loads = tuple(
            FingerLoad(k0=row.k0_n_per_m, d0=row.d0_n_s_per_m, branches=row.branches)
            for row in finger.table
        )
        return FingerTable(
            normal_force=tuple(row.normal_force_n for row in finger.table), loads=loads
        )
    assert finger.k0_n_per_m is not None
    assert finger.d0_n_s_per_m is not None
    return FingerLoad(k0=finger.k0_n_per_m, d0=finger.d0_n_s_per_m, branches=finger.branches)


def _amplifier(table: AmplifierTable) -> Amplifier:
    """Return the amplifier that a table describes."""
    return Amplifier(
        gain=table.gain,
        bandwidth=math.inf if table.bandwidth_hz is None else table.bandwidth_hz,
        output_resistance=table.output_resistance_ohm,
        hold=table.hold,
        delay=table.delay_us * 1e-6,
        audio_full_scale=table.audio_full_scale_v,
        ac_coupling=table.ac_coupling_hz or 0.0,
    )


def _limits(table: LimitsTable) -> DriveLimits:
    """Return the limits that a table describes."""
    return DriveLimits(
        voltage=table.voltage_v,
        slew=table.slew_v_per_us * 1e6,
        current=math.inf if table.current_ma is None else table.current_ma * 1e-3,
        fade=table.fade_ms * 1e-3,
    )


def _measured(
    content: DisplayFile,
    contactors: tuple[Contactor, ...],
    response: Callable[[str], MeasuredResponse],
) -> tuple[tuple[MeasuredResponse, ...], NDArray[np.intp]]:
    """Return the measured responses, and the index of each contactor's own, from 1 (0: none)."""
    responses: list[str | None] = [c.response for c in contactors]
    own = [name is not None for name in responses]
    for i, group in enumerate(content.group):
        for member in group.contactors or range(len(contactors)):
            if member >= len(contactors):
                raise InputError(f"group[{i}].contactors: {member} is not below {len(contactors)}")
            if not own[member]:
                responses[member] = group.response
    names = sorted({name for name in responses if name is not None})
    kind = [0 if name is None else names.index(name) + 1 for name in responses]
    return tuple(response(name) for name in names), np.array(kind, np.intp)


def load_response(path: str | Path) -> MeasuredResponse:
    """Read a measured response from a CSV file.

    Parameters
    ----------
    path : str or Path
        File with the columns frequency_hz, magnitude, phase_deg and unit.

    Returns
    -------
    MeasuredResponse
        The response in SI units.

    Raises
    ------
    NotFoundError
        If there is no such file.
    InputError
        If the file is not valid; the message gives file, field, value and limit in one line.
    """
    return _response(files.read_table(Path(path)), Path(path))


def _response(text: str, path: Path) -> MeasuredResponse:
    """Return the measured response that the text of a CSV file gives."""
    rows = files.parse_columns(text, path, COLUMNS)
    values = files.numbers(path, COLUMNS[:3], rows)
    for row in rows:
        if row.cells[3] not in UNITS:
            raise InputError(
                f"{path}: line {row.line}: unit = {row.cells[3]!r}: "
                f"must be one of {', '.join(UNITS)}"
            )
    scale = np.array([UNITS[row.cells[3]] for row in rows])
    if len(values) < 2 or np.any(np.diff(values[:, 0]) <= 0) or np.any(values[:, 1] <= 0):
        raise InputError(f"{path}: needs ascending frequencies and magnitudes above 0, two or more")
    low, high = MEASURED_BAND
    if values[0, 0] > low or values[-1, 0] < high:
        raise InputError(
            f"{path}: frequency_hz: covers {values[0, 0]:g} … {values[-1, 0]:g} Hz, "
            f"must cover {low:g} … {high:g} Hz"
        )
    return MeasuredResponse(values[:, 0], values[:, 1] * scale, np.radians(values[:, 2]))


def _check_geometry(display: Display) -> None:
    """Raise InputError for a display that cannot be built or must not be driven."""
    highest = display.limits.voltage * display.amplifier.peak
    share, reason = display.actuator.overload(highest)
    if share > 1:
        largest = _three_digits_below(display.limits.voltage / share)
        swing = ", twice that behind AC coupling" if display.amplifier.ac_coupling else ""
        raise InputError(
            f"limits.voltage_v = {display.limits.voltage:g}{swing}: {reason}; at most {largest:g} V"
        )
    needs = display.actuator.size(highest)
    for need, has, side in zip(needs, display.opening, ("along", "across"), strict=True):
        if need > has:
            raise InputError(
                f"display.opening_mm: {has * 1e3:g} mm {side} the shear direction, "
                f"the actuator with its travel needs {need * 1e3:.2f} mm"
            )
    channels, counts = np.unique(display.channel, return_counts=True)
    if np.any(counts > 1):
        raise InputError(f"channel {channels[np.argmax(counts)]} drives more than one contactor")
    overlap = _first_overlap(display)
    if overlap is not None:
        raise InputError(
            f"contactors {overlap[0]} and {overlap[1]} overlap: their openings of "
            f"{display.opening[0] * 1e3:g} × {display.opening[1] * 1e3:g} mm meet"
        )


def _three_digits_below(value: float) -> float:
    """Return a value rounded down to three significant digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.floor(value / unit * (1 + 1e-12)) * unit


def _first_overlap(display: Display) -> tuple[int, int] | None:
    """Return the first two contactors whose openings overlap, by the separating axis theorem.

    Two rectangles are disjoint if a side of either of them separates the two.
    """
    axis = display.shear_axes
    frames = np.stack([axis, np.stack([-axis[:, 1], axis[:, 0]], axis=1)], axis=1)
    half = np.asarray(display.opening) / 2
    offset = display.contactors[None] - display.contactors[:, None]
    reach = np.abs(np.einsum("iax,jbx->ijab", frames, frames)) @ half + half
    apart = np.abs(np.einsum("iax,ijx->ija", frames, offset)) >= reach * (1 - 1e-9)
    meets = ~(apart.any(axis=2) | apart.any(axis=2).T)
    np.fill_diagonal(meets, False)
    if not meets.any():
        return None
    first = np.argwhere(meets)[0]
    return int(first[0]), int(first[1])
