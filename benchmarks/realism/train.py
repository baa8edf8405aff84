"""Training of the example model: ``python -m benchmarks.realism.train FABRIC MODEL.onnx``."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from benchmarks.fit import FABRIC_NAMES, FABRICS, fabric, recordings
from benchmarks.realism.learned import regression_of, write_model
from tactile.files import check_target, nearest
from tactile.texture.fitting import RecordingMeasures, measure_slides

SOURCE = "accelerometer under {name}, bare finger at 20, 30, 50 and 60 mm/s (Fradin et al., 2023)"
"""Template of the origin of a model."""


def main(
    name: Annotated[str, typer.Argument(metavar="FABRIC", help="Fabric: denim or corduroy.")],
    target: Annotated[Path, typer.Argument(metavar="MODEL", help="ONNX file to write.")],
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
) -> None:
    """Learn the levels of a fabric from its four recordings, and print the error on each left out.

    The recordings have to be in shared/data next to the project, or in the folder that TACTILE_DATA
    names; they are not shipped, and neither is a model of them. `tactile convert` makes a texture
    of the model.

    Example: python -m benchmarks.realism.train denim denim.onnx
    """
    folder = recordings()
    if folder is None:
        raise typer.BadParameter("no recordings: set TACTILE_DATA to a folder with textsense")
    if name not in FABRIC_NAMES:
        raise typer.BadParameter(f"{name!r}: {nearest(name, list(FABRIC_NAMES))}")
    check_target(target, force=force)
    measured = measure_slides([fabric(folder, name, key) for key in FABRICS])
    errors = list(held_out(measured))
    for speed, error in zip(measured.speed, errors, strict=True):
        print(f"held out at {speed * 1e3:g} mm/s: {error:.2f} dB mean absolute error over bands")
    print(f"mean: {np.mean(errors):.2f} dB")
    write_model(
        target, regression_of(measured), source=SOURCE.format(name=name), category="textile"
    )
    print(f"written: {target}, trained on all four")


def held_out(measured: RecordingMeasures) -> Iterator[float]:
    """Compute how well each recording is predicted by the others.

    Parameters
    ----------
    measured : RecordingMeasures
        Levels of recordings, calibrated.

    Yields
    ------
    float
        Mean absolute error over the bands that this recording and another one cover [dB].
    """
    for row in range(len(measured.slides)):
        others = measured.part([k for k in range(len(measured.slides)) if k != row])
        learned = regression_of(others)
        real = measured.level[row, np.isin(measured.center, learned.center)]
        made = learned.at(measured.speed[[row]], measured.force[[row]])[0]
        yield float(np.nanmean(np.abs(made - real)))


if __name__ == "__main__":
    typer.run(main)
