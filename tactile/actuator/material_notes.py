"""Sources of the material constants, and the coercive fields of the ceramics.

There is a note for each name of `materials.PIEZOS` and `materials.SHIMS`: a one-line description,
the source of the constants with whatever is assumed of them, and the coercive field. Half the
coercive field is a prudent limit for the drive: beyond it a soft ceramic creeps, and near the
coercive field it is depoled.

The CTS, piezo.com and APC data sheets and appendix E of Erturk & Inman were read for this. PZT-4,
PZT-8, PIC 255 and the metals are quoted from their sources at second hand; their constants agree
with the coupling, the modulus and the speed of sound that are quoted for them
(tests/test_materials.py).
"""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class MaterialNote:
    """Description, source and coercive field of a material, besides its constants.

    Parameters
    ----------
    description : str
        Description in one line.
    source : str
        Source of the constants, and which of them are assumed.
    coercive_field : float or None
        Quasi-static coercive field of a piezoceramic [V/m]; None if none is published.
    """

    description: str
    source: str
    coercive_field: float | None = None


_CLEVITE = (
    "Berlincourt, Krueger & Near, Properties of Piezoelectricity Ceramics, Morgan TP-226; "
    "tanθ assumed"
)
"""Source of PZT-4 and PZT-8."""
_ERTURK = "Erturk & Inman 2011, Piezoelectric Energy Harvesting, appendix E (after TP-226); "
"""Beginning of the source of PZT-5A and PZT-5H."""

MATERIAL_NOTES = {
    "3203hd": MaterialNote(
        description="soft, high strain (PZT-5H kind); surrogate of VIBRIT 1100",
        source="CTS 3203HD data sheet; s55E like PZT-5H; Q and tanθ assumed",
        coercive_field=0.8e6,
    ),
    "5a4e": MaterialNote(
        description="soft, of the piezo.com benders (PZT-5A kind)",
        source="piezo.com material sheet 2020 (PZT-5A); density 7800 kg/m³ and tanθ "
        "assumed. Its constants make k31 0.39, it prints 0.35",
        coercive_field=1.2e6,
    ),
    "apc-855": MaterialNote(
        description="soft, high strain (Navy VI, PZT-5H kind)",
        source="APC International data sheet 2017; s55E like PZT-5H, tanθ assumed",
    ),
    "pic-255": MaterialNote(
        description="soft, for actuators (PZT-5A kind)",
        source="PI Ceramic material data; s55E = 1/(21 GPa), the cE44 of the plutho project; "
        "tanθ assumed",
    ),
    "pzt-4": MaterialNote(description="hard, low loss, for strong drive", source=_CLEVITE),
    "pzt-5a": MaterialNote(
        description="soft, stable with temperature",
        source=_ERTURK + "Q and tanδ TP-226, coercive field piezo.com sheet 2020; tanθ assumed",
        coercive_field=1.2e6,
    ),
    "pzt-5h": MaterialNote(
        description="soft, high strain",
        source=_ERTURK + "Q and tanδ TP-226, coercive field piezo.com sheet 2020; tanθ assumed",
        coercive_field=0.8e6,
    ),
    "pzt-8": MaterialNote(description="hard, lowest loss, least strain", source=_CLEVITE),
    "alumina": MaterialNote(
        description="ceramic, 96 % Al2O3", source="CoorsTek AD-96 data sheet; Q assumed"
    ),
    "brass": MaterialNote(
        description="cartridge brass, CuZn30", source="ASM data of C26000; Q assumed"
    ),
    "cfrp": MaterialNote(
        description="carbon-fiber laminate along its fibers; the default",
        source="all assumed, typical",
    ),
    "fr4": MaterialNote(
        description="glass-fiber epoxy, a printed circuit board", source="all assumed, typical"
    ),
    "steel": MaterialNote(description="stainless, 304", source="ASM data of 304; Q assumed"),
    "titanium": MaterialNote(description="Ti-6Al-4V", source="ASM data of Ti-6Al-4V; Q assumed"),
}
"""Notes by name of the material, for each name of `PIEZOS` and `SHIMS`."""
