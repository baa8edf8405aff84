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
        Name of the display, in lower case with hyphens.
    description : str
        Description in plain text.
    opening_mm : tuple of float
        Size of the opening of a contactor along and across its shear direction [mm].
    shear_projection : {"none", "motion"}
        Whether shear is projected on the direction of motion.
    """

    id: Annotated[str, Meta(pattern="^[a-z0-9]+(-[a-z0-9]+)*$")]
    description: str
    opening_mm: tuple[Millimeters, Millimeters]
    shear_projection: Literal["none", "motion"] = "none"


class Grid(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table ``[grid]``: contactors on a rectangular grid around the origin, numbered along x first.

    Attributes
    ----------
    columns, rows : int
        Number of contactors along x and along y.
    pitch_mm : tuple of float
        Distance between neighbors along x and along y [mm].
    shear_direction_deg : float
        Shear direction of all contactors, from the x axis [°].
    polarity : {-1, 1}
        Sign of the shear along the shear direction for a positive drive.
    first_channel : int
        Channel of the first contactor; the others follow in order.
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
        Position (x, y) under the finger [mm].
    channel : int
        Channel that drives the contactor.
    shear_direction_deg : float
        Shear direction, from the x axis [°].
    polarity : {-1, 1}
        Sign of the shear along the shear direction for a positive drive.
    response : str or None
        File of a measured response, relative to the display file.
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
        File of the measured response, relative to the display file.
    contactors : tuple of int
        Numbers of the contactors; empty for all of them.
    """

    response: str
    contactors: tuple[Index, ...] = ()


class BimorphTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table ``[bimorph]``: geometry, materials by name, and wiring of the bender.

    The last six keys are adjusted constants, such as a fit to a measurement writes. They take
    precedence over those of the named material.

    Attributes
    ----------
    width_mm, length_mm, clamped_length_mm : float
        Width, free length and clamped length [mm].
    piezo_height_mm, shim_height_mm : float
        Thickness of one piezo layer and of the shim [mm].
    layer_stiffening : bool
        Whether the stiffening by the field within the layers is modeled (see `Bimorph`).
    piezo, shim : str
        Names of the materials in `PIEZOS` and `SHIMS`.
    wiring : {"parallel", "series"}
        Wiring of the piezo layers.
    s11e_um2_per_n : float or None
        Compliance s11E of the piezo layers [µm²/N].
    d31_pm_per_v : float or None
        Piezoelectric charge constant d31 [pm/V].
    eps33t_relative : float or None
        Relative permittivity ε33T/ε0.
    piezo_quality, shim_quality : float or None
        Mechanical quality factors of the piezo layers and of the shim.
    loss_tangent : float or None
        Dielectric loss tangent tanδ of the piezo layers.
    """

    width_mm: Annotated[float, Meta(ge=0.1, le=50)] = 2.1
    length_mm: Annotated[float, Meta(ge=1, le=100)] = 20.0
    clamped_length_mm: Annotated[float, Meta(ge=0, le=100)] = 5.0
    piezo_height_mm: Annotated[float, Meta(ge=0.01, le=5)] = 0.26
    shim_height_mm: Annotated[float, Meta(ge=0, le=5)] = 0.20
    layer_stiffening: bool = False
    piezo: str = "3203hd"
    shim: str = "cfrp"
    wiring: Literal["parallel", "series"] = "parallel"
    s11e_um2_per_n: Annotated[float, Meta(ge=2, le=100)] | None = None
    d31_pm_per_v: Annotated[float, Meta(ge=-2000, le=-1)] | None = None
    eps33t_relative: Annotated[float, Meta(ge=100, le=20000)] | None = None
    piezo_quality: Quality | None = None
    shim_quality: Quality | None = None
    loss_tangent: Annotated[float, Meta(ge=0, le=0.5)] | None = None

    def __post_init__(self) -> None:
        for name, least in (("clamped_length_mm", 0.1), ("shim_height_mm", 0.005)):
            value = getattr(self, name)
            if 0 < value < least:
                raise ValueError(f"{name} = {value:g}: must be 0 or at least {least:g}")


class VoiceCoilTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Table ``[voice_coil]``, in place of ``[bimorph]``: an actuator by its measured response.

    Attributes
    ----------
    response : str
        File of the shear displacement per volt at the terminals, measured under a finger; relative
        to the display file.
    resistance_ohm, inductance_mh : float
        Resistance [Ω] and inductance [mH] of the coil.
    current_a : float
        Current that the coil withstands for good [A].
    size_mm : tuple of float
        Size at rest along and across the shear direction [mm].
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
        Normal force [N].
    k0_n_per_m : float
        Parallel stiffness [N/m].
    d0_n_s_per_m : float
        Parallel damping [N s/m].
    branches : tuple of (float, float)
        Stiffness [N/m] and damping [N s/m] of each Maxwell branch.
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
        Name of a preset of `FingerLoad`.
    k0_n_per_m : float or None
        Parallel stiffness [N/m].
    d0_n_s_per_m : float or None
        Parallel damping [N s/m].
    branches : tuple of (float, float)
        Stiffness [N/m] and damping [N s/m] of each Maxwell branch.
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
        Output voltage per volt of drive.
    bandwidth_hz : float or None
        Corner frequency of the first-order low-pass [Hz].
    output_resistance_ohm : float
        Resistance in series with the bimorph [Ω].
    hold : {"none", "zoh"}
        Whether each sample is held until the next one ("zoh").
    delay_us : float
        Delay of the output [µs].
    audio_full_scale_v : float or None
        Drive at digital full scale of an audio card [V].
    ac_coupling_hz : float or None
        Corner frequency of the first-order high-pass at the outputs of an audio card [Hz].
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
        Largest magnitude of the drive [V].
    slew_v_per_us : float
        Largest rate of change of the drive [V/µs].
    current_ma : float or None
        Largest current of one channel [mA].
    fade_ms : float
        Length of the ordinary ramp to or from 0 V [ms].
    """

    voltage_v: Annotated[float, Meta(gt=0, le=1000)]
    slew_v_per_us: Annotated[float, Meta(gt=0, le=100)] = 0.7
    current_ma: Annotated[float, Meta(gt=0, le=10000)] | None = None
    fade_ms: Annotated[float, Meta(ge=1, le=1000)] = 20.0


class DisplayFile(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Content of a display file; contactors are given either as ``[grid]`` or as ``[[contactor]]``.

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
