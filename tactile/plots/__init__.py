"""Figures for files: bimorphs, strokes, textures. The only room of matplotlib.

What a bimorph can do (`response_plots`), what was played (`played_plots`), what a texture is
(`texture_plots`), many of them (`sheet_plots`), how one was fitted (`fit_plots`), how a model lies
on measurements (`adjust_plots`), and studies of a design (`study_plots`).
``…_figure`` draws, ``plot_…`` also saves.
"""

from tactile.plots.adjust_plots import adjusted_figure as adjusted_figure
from tactile.plots.adjust_plots import plot_adjusted as plot_adjusted
from tactile.plots.fit_plots import fit_figure as fit_figure
from tactile.plots.fit_plots import plot_fit as plot_fit
from tactile.plots.played_plots import Played as Played
from tactile.plots.played_plots import played_figure as played_figure
from tactile.plots.played_plots import plot_played as plot_played
from tactile.plots.response_plots import plot_response as plot_response
from tactile.plots.response_plots import response_figure as response_figure
from tactile.plots.sheet_plots import plot_sheet as plot_sheet
from tactile.plots.sheet_plots import sheet_figure as sheet_figure
from tactile.plots.study_plots import criterion_figure as criterion_figure
from tactile.plots.study_plots import length_map_figure as length_map_figure
from tactile.plots.study_plots import pareto_figure as pareto_figure
from tactile.plots.study_plots import plot_criterion as plot_criterion
from tactile.plots.study_plots import plot_length_map as plot_length_map
from tactile.plots.study_plots import plot_pareto as plot_pareto
from tactile.plots.study_plots import plot_response_phase as plot_response_phase
from tactile.plots.study_plots import plot_tolerance as plot_tolerance
from tactile.plots.study_plots import response_phase_figure as response_phase_figure
from tactile.plots.study_plots import tolerance_figure as tolerance_figure
from tactile.plots.style import check_file as check_file
from tactile.plots.style import drawn as drawn
from tactile.plots.style import save as save
from tactile.plots.texture_plots import plot_texture as plot_texture
from tactile.plots.texture_plots import texture_figure as texture_figure
