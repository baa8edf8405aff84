"""Tables of a display's TOML file: their keys, with units in the names, and the allowed ranges."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

Millimeters = Annotated[float, Meta(gt=0, le=200)]
"""Length [mm]."""
Place = Annotated[float, Meta(ge=-500, le=500)]
"""Coordinate [mm]."""
Degrees = Annotated[float, Meta(ge=-360, le=360)]
"""Angle [°]."""
Stiffness = Annotated[float, Meta(ge=0, le=1e6)]
"""Stiffness [N/m]."""
Damping = Annotated[float, Meta(ge=0, le=1e3)]
"""Damping [N s/m]."""
Quality = Annotated[float, Meta(ge=1, le=1e5)]
"""Mechanical quality factor."""
CHANNELS = 4096
"""Number of channels that a display may have; channel numbers are below it."""
Channel = Annotated[int, Meta(ge=0, lt=CHANNELS)]
"""Channel number, from 0."""
Index = Annotated[int, Meta(ge=0)]
"""Contactor number, from 0."""


class AboutTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table ``[display]``: what the display is.

    Attributes
    ----------
    id : str
        Name of the display: lower-case words joined by hyphens.
    description : str
        One line for people.
    opening_mm : tuple of float
        Opening in the surface around each contactor: along and across its shear direction. It
        must hold the bender with its travel at the voltage limit.
    shear_projection : {"none", "motion"}
        `none` plays each texture along the contactor's own axis in whatever direction the
        finger moves; `motion` multiplies it by the cosine of the angle between that axis and
        the motion.
    """

    id: Annotated[str, Meta(pattern="^[a-z0-9]+(-[a-z0-9]+)*$")]
    description: str
    opening_mm: tuple[Millimeters, Millimeters]
    shear_projection: Literal["none", "motion"] = "none"


class Grid(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table ``[grid]``: contactors on a rectangular grid around the origin, numbered along x first.

    Attributes
    ----------
    columns : int
        Contactors along x. A file has either `[grid]` or `[[contactor]]` tables.
    rows : int
        Contactors along y.
    pitch_mm : tuple of float
        Distance between neighbors along x and along y; the grid is centered on the origin.
    shear_direction_deg : float
        Direction in which positive shear of every contactor points, from the x axis.
    polarity : {-1, 1}
        −1 where positive volts shear against the shear direction.
    first_channel : int
        Channel of the first contactor; the others follow along x first.
    """

    columns: Annotated[int, Meta(ge=1, le=64)]
    rows: Annotated[int, Meta(ge=1, le=64)]
    pitch_mm: tuple[Millimeters, Millimeters]
    shear_direction_deg: Degrees = 0.0
    polarity: Literal[-1, 1] = 1
    first_channel: Channel = 0

    def __post_init__(self) -> None:
        last = self.first_channel + self.columns * self.rows - 1
        if last >= CHANNELS:
            raise ValueError(f"last channel {last}: must be below {CHANNELS}")


class Contactor(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table ``[[contactor]]``: one contactor.

    Attributes
    ----------
    position_mm : tuple of float
        Place under the finger, x and y.
    channel : int
        Drive line; each drives one contactor.
    shear_direction_deg : float
        Direction in which positive shear points, from the x axis.
    polarity : {-1, 1}
        −1 where positive volts shear against the shear direction.
    response : str or None
        File with a measured response that replaces the model for this contactor: a CSV beside
        the display file with the columns `frequency_hz,magnitude,phase_deg,unit`, where the
        unit is `m/V`, `um/V` or `nm/V`; it must cover 20 … 1000 Hz.
    """

    position_mm: tuple[Place, Place]
    channel: Channel
    shear_direction_deg: Degrees = 0.0
    polarity: Literal[-1, 1] = 1
    response: str | None = None


class Group(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table ``[[group]]``: contactors that share a measured response.

    A contactor's own response takes precedence over that of its group.

    Attributes
    ----------
    response : str
        File with a measured response, as of a contactor.
    contactors : tuple of int
        Numbers of the contactors that share it; all where none are named. A contactor's own
        response has priority.
    """

    response: str
    contactors: tuple[Index, ...] = ()


class BimorphTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table ``[bimorph]``: geometry, materials by name, and wiring of the bender.

    Every key replaces a value of the named bender, or of the default design. The last six keys are
    adjusted constants, such as a fit to a measurement writes. They take precedence over those of
    the named material.

    Attributes
    ----------
    bender : str or None
        Name of a commercial bender; `tactile materials` lists them. Without it, the default design:
        2.1 mm wide, 20 mm free and 5 mm clamped, layers of 0.26 mm of 3203hd around 0.2 mm of cfrp.
    width_mm : float or None
        Width of the bender.
    length_mm : float or None
        Free length, from the clamp to the tip.
    clamped_length_mm : float or None
        Length within the clamp, which adds capacitance only: 0, or at least 0.1.
    piezo_height_mm : float or None
        Height of each of the two piezo layers.
    shim_height_mm : float or None
        Height of the layer between them: 0, or at least 0.005.
    layer_stiffening : bool
        Whether the field that bending induces within each piezo layer stiffens it; the paper's
        model leaves this out (see [the physics](/guide/physics.md)).
    piezo : str or None
        Name of the piezoceramic; `tactile materials` lists them.
    shim : str or None
        Name of the material of the shim; `tactile materials` lists them.
    wiring : {"parallel", "series"} or None
        `parallel`: the shim against both outer electrodes; `series`: one outer electrode
        against the other.
    s11e_um2_per_n : float or None
        Compliance that replaces the named material's. This key and those below are constants as
        `tactile adjust` fits them to a measurement.
    d31_pm_per_v : float or None
        Piezoelectric constant that replaces the named material's.
    eps33t_relative : float or None
        Relative permittivity at constant stress that replaces the named material's.
    piezo_quality : float or None
        Mechanical quality factor of the piezoceramic.
    shim_quality : float or None
        Mechanical quality factor of the shim.
    loss_tangent : float or None
        Dielectric loss tangent of the piezoceramic.
    """

    bender: str | None = None
    width_mm: Annotated[float, Meta(ge=0.1, le=50)] | None = None
    length_mm: Annotated[float, Meta(ge=1, le=100)] | None = None
    clamped_length_mm: Annotated[float, Meta(ge=0, le=100)] | None = None
    piezo_height_mm: Annotated[float, Meta(ge=0.01, le=5)] | None = None
    shim_height_mm: Annotated[float, Meta(ge=0, le=5)] | None = None
    layer_stiffening: bool = False
    piezo: str | None = None
    shim: str | None = None
    wiring: Literal["parallel", "series"] | None = None
    s11e_um2_per_n: Annotated[float, Meta(ge=2, le=100)] | None = None
    d31_pm_per_v: Annotated[float, Meta(ge=-2000, le=-1)] | None = None
    eps33t_relative: Annotated[float, Meta(ge=100, le=20000)] | None = None
    piezo_quality: Quality | None = None
    shim_quality: Quality | None = None
    loss_tangent: Annotated[float, Meta(ge=0, le=0.5)] | None = None

    def __post_init__(self) -> None:
        for name, least in (("clamped_length_mm", 0.1), ("shim_height_mm", 0.005)):
            value = getattr(self, name)
            if value is not None and 0 < value < least:
                raise ValueError(f"{name} = {value:g}: must be 0 or at least {least:g}")


class VoiceCoilTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table ``[voice_coil]``, in place of ``[bimorph]``: an actuator by its measured response.

    Attributes
    ----------
    response : str
        File of the shear displacement per volt at the terminals, measured under a finger; relative
        to the display file.
    resistance_ohm : float
        Resistance of the coil.
    inductance_mh : float
        Inductance of the coil.
    current_a : float
        Current that the coil withstands for good.
    size_mm : tuple of float
        Size at rest along and across the shear direction.
    """

    response: str
    resistance_ohm: Annotated[float, Meta(gt=0, le=1e6)]
    inductance_mh: Annotated[float, Meta(ge=0, le=1e6)] = 0.0
    current_a: Annotated[float, Meta(gt=0, le=100)]
    size_mm: tuple[Millimeters, Millimeters]


class FingerRow(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table ``[[finger.table]]``: the load of the finger at one normal force.

    Attributes
    ----------
    normal_force_n : float
        Normal force at which this row was measured; between rows the load is interpolated.
    k0_n_per_m : float
        As in `[finger]`.
    d0_n_s_per_m : float
        As in `[finger]`.
    branches : tuple of (float, float)
        As in `[finger]`.
    """

    normal_force_n: Annotated[float, Meta(gt=0, le=50)]
    k0_n_per_m: Stiffness
    d0_n_s_per_m: Damping
    branches: tuple[tuple[Stiffness, Damping], ...] = ()


class FingerLoadTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table ``[finger]``: the load as a preset, as constants, or as a table over normal force.

    Attributes
    ----------
    preset : {"low", "high", "none"} or None
        One of the two fingers of Hofmann & Twiefel 2014, `low` and `high` normal load, or
        `none` for air.
    k0_n_per_m : float or None
        Stiffness of the parallel spring. The table needs exactly one of: `preset`; `k0_n_per_m`
        with `d0_n_s_per_m` and any `branches`; `[[finger.table]]`.
    d0_n_s_per_m : float or None
        Damping of the parallel damper.
    branches : tuple of (float, float)
        Maxwell branches, each a stiffness in N/m and a damping in N s/m in series.
    table : tuple of FingerRow
        Loads at several normal forces.
    """

    preset: Literal["low", "high", "none"] | None = None
    k0_n_per_m: Stiffness | None = None
    d0_n_s_per_m: Damping | None = None
    branches: tuple[tuple[Stiffness, Damping], ...] = ()
    table: tuple[FingerRow, ...] = ()

    def __post_init__(self) -> None:
        both = self.k0_n_per_m is not None and self.d0_n_s_per_m is not None
        either = self.k0_n_per_m is not None or self.d0_n_s_per_m is not None or self.branches
        ways = [self.preset is not None, bool(either), bool(self.table)]
        if ways.count(True) != 1 or (either and not both):
            raise ValueError(
                "needs either preset, or k0_n_per_m, d0_n_s_per_m and branches, or table"
            )


class AmplifierTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table ``[amplifier]``; without it the amplifier is ideal.

    Attributes
    ----------
    gain : float
        Volts at the electrodes per volt of drive.
    bandwidth_hz : float or None
        Corner of the amplifier's first-order low-pass.
    output_resistance_ohm : float
        Resistance in series with the bender.
    hold : {"none", "zoh"}
        `none`: the output is band-limited through the samples; `zoh`: each sample is held until
        the next, which needs a bandwidth or an output resistance.
    delay_us : float
        Delay of the amplifier.
    audio_full_scale_v : float or None
        Volts of drive at digital full scale of a sound card; needed by `audio:` devices.
    ac_coupling_hz : float or None
        Corner of the high-pass of a sound card whose outputs are coupled by capacitors.
    """

    gain: Annotated[float, Meta(gt=0, le=1000)] = 1.0
    bandwidth_hz: Annotated[float, Meta(gt=0)] | None = None
    output_resistance_ohm: Annotated[float, Meta(ge=0, le=1e6)] = 0.0
    hold: Literal["none", "zoh"] = "none"
    delay_us: Annotated[float, Meta(ge=0, le=20000)] = 0.0
    audio_full_scale_v: Annotated[float, Meta(gt=0, le=10000)] | None = None
    ac_coupling_hz: Annotated[float, Meta(ge=0.01, le=50)] | None = None


class LimitsTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table ``[limits]``: what must never be exceeded.

    Attributes
    ----------
    voltage_v : float
        Largest drive on either side of 0 V. The electrodes see the amplifier's gain times that.
    slew_v_per_us : float
        Largest rate at which the drive changes.
    current_ma : float or None
        Largest current of one channel. Into the capacitance of a bender it lowers the slew limit
        where the amplifier cannot keep up; a voltage limit at which a coil would take more is
        refused.
    fade_ms : float
        Length of the ordinary ramp to and from 0 V.
    """

    voltage_v: Annotated[float, Meta(gt=0, le=1000)]
    slew_v_per_us: Annotated[float, Meta(gt=0, le=100)] = 0.7
    current_ma: Annotated[float, Meta(gt=0, le=10000)] | None = None
    fade_ms: Annotated[float, Meta(ge=1, le=1000)] = 20.0


class DisplayFile(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Content of a display file; contactors are given either as ``[grid]`` or as ``[[contactor]]``.

    A display file is a TOML file that describes one array: where its contactors stand, which
    channel drives each, which bender, finger and amplifier it has, and which limits must never be
    exceeded. It is given by `--display my-display.toml` or
    `tactile.load_display("my-display.toml")`; the two shipped displays are named `reference-24` and
    `reference-64`. Units are part of the name of each key, unknown keys are errors, and every
    number must be finite. Contactors and channels are counted from 0. A file that cannot be built
    is refused as well: openings that overlap, a bender that does not fit its opening with its
    travel, two contactors on one channel, or a voltage limit above 400 V/mm of field in the piezo
    layers.

    Attributes
    ----------
    display : AboutTable
        What the display is.
    finger : FingerLoadTable
        Load on the tips of the benders.
    limits : LimitsTable
        Limits of the drive.
    grid : Grid or None
        Contactors on a grid.
    contactor : tuple of Contactor
        Contactors one by one.
    group : tuple of Group
        Measured responses of several contactors.
    bimorph : BimorphTable or None
        Bender of every contactor; one with all defaults if no other actuator is given.
    voice_coil : VoiceCoilTable or None
        Actuator of every contactor, in place of a bender.
    amplifier : AmplifierTable
        Amplifier of every channel.
    """

    display: AboutTable
    finger: FingerLoadTable
    limits: LimitsTable
    grid: Grid | None = None
    contactor: tuple[Contactor, ...] = ()
    group: tuple[Group, ...] = ()
    bimorph: BimorphTable | None = None
    voice_coil: VoiceCoilTable | None = None
    amplifier: AmplifierTable = AmplifierTable()

    def __post_init__(self) -> None:
        if (self.grid is None) == (not self.contactor):
            raise ValueError("needs either [grid] or [[contactor]]")
        if self.bimorph is not None and self.voice_coil is not None:
            raise ValueError("has both [bimorph] and [voice_coil]; a display has one actuator")
