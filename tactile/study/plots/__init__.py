"""Figures of design studies for files: criteria, maps, fronts, tolerances and fits to measurements.

`tactile.show.plots.save` writes a figure to a file.
"""

from tactile.study.plots.adjusted import adjusted_figure as adjusted_figure
from tactile.study.plots.studies import criterion_figure as criterion_figure
from tactile.study.plots.studies import length_map_figure as length_map_figure
from tactile.study.plots.studies import pareto_figure as pareto_figure
from tactile.study.plots.studies import response_phase_figure as response_phase_figure
from tactile.study.plots.studies import tolerance_figure as tolerance_figure
