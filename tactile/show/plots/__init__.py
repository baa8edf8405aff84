"""Figures for files, drawn with matplotlib: bimorphs, strokes, textures and their fits.

`save` writes a figure to a file. `tactile.study.plots` has the figures of design studies.
"""

from tactile.show.plots.calibration import calibration_figure as calibration_figure
from tactile.show.plots.effect import effect_figure as effect_figure
from tactile.show.plots.finger import finger_figure as finger_figure
from tactile.show.plots.fit import fit_figure as fit_figure
from tactile.show.plots.played import Played as Played
from tactile.show.plots.played import played_figure as played_figure
from tactile.show.plots.response import response_figure as response_figure
from tactile.show.plots.sheet import sheet_figure as sheet_figure
from tactile.show.plots.style import check_file as check_file
from tactile.show.plots.style import drawn as drawn
from tactile.show.plots.style import save as save
from tactile.show.plots.texture import texture_figure as texture_figure
