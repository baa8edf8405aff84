"""What a display's TOML file may say: its tables, their keys with units, and their ranges."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

Millimeters = Annotated[float, Meta(gt=0, le=200)]
Place = Annotated[float, Meta(ge=-500, le=500)]
Degrees = Annotated[float, Meta(ge=-360, le=360)]
Stiffness = Annotated[float, Meta(ge=0, le=1e6)]
Damping = Annotated[float, Meta(ge=0, le=1e3)]
Quality = Annotated[float, Meta(ge=1, le=1e5)]
CHANNELS = 4096
Channel = Annotated[int, Meta(ge=0, lt=CHANNELS)]
Index = Annotated[int, Meta(ge=0)]


class AboutTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the display is."""

    id: Annotated[str, Meta(pattern="^[a-z0-9]+(-[a-z0-9]+)*$")]
    description: str
    opening_mm: tuple[Millimeters, Millimeters]
    shear_projection: Literal["none", "motion"] = "none"


class Grid(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Contactors on a rectangular grid around the origin; numbered along x first."""

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
    """One contactor."""

    position_mm: tuple[Place, Place]
    channel: Channel
    shear_direction_deg: Degrees = 0.0
    polarity: Literal[-1, 1] = 1
    response: str | None = None


class Group(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Contactors that share a measured response: all of them where none are named.

    A contactor's own response goes before its group's.
    """

    response: str
    contactors: tuple[Index, ...] = ()


class BimorphTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The bender: geometry, materials by name, wiring.

    The last five are adjusted constants, such as a fit to a measurement writes: they go before
    those of the named material.
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


class FingerRow(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A load at one normal force."""

    normal_force_n: Annotated[float, Meta(gt=0, le=50)]
    k0_n_per_m: Stiffness
    d0_n_s_per_m: Damping
    branches: tuple[tuple[Stiffness, Damping], ...] = ()


class FingerLoadTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The load: a preset, its constants, or a table over normal force."""

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
    """The amplifier; without it an ideal one."""

    gain: Annotated[float, Meta(gt=0, le=1000)] = 1.0
    bandwidth_hz: Annotated[float, Meta(gt=0)] | None = None
    output_resistance_ohm: Annotated[float, Meta(ge=0, le=1e6)] = 0.0
    hold: Literal["none", "zoh"] = "none"
    delay_us: Annotated[float, Meta(ge=0, le=20000)] = 0.0
    audio_full_scale_v: Annotated[float, Meta(gt=0, le=10000)] | None = None
    ac_coupling_hz: Annotated[float, Meta(ge=0.01, le=50)] | None = None


class LimitsTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What must never be exceeded."""

    voltage_v: Annotated[float, Meta(gt=0, le=1000)]
    slew_v_per_us: Annotated[float, Meta(gt=0, le=100)] = 0.7
    current_ma: Annotated[float, Meta(gt=0, le=10000)] | None = None
    fade_ms: Annotated[float, Meta(ge=1, le=1000)] = 20.0


class DisplayFile(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A display, as in its file."""

    display: AboutTable
    finger: FingerLoadTable
    limits: LimitsTable
    grid: Grid | None = None
    contactor: tuple[Contactor, ...] = ()
    group: tuple[Group, ...] = ()
    bimorph: BimorphTable = BimorphTable()
    amplifier: AmplifierTable = AmplifierTable()

    def __post_init__(self) -> None:
        if (self.grid is None) == (not self.contactor):
            raise ValueError("needs either [grid] or [[contactor]]")
