"""Figures of design studies for files: criteria, maps, fronts, tolerances and fits to measurements.

Functions ``…_figure`` draw a figure; functions ``plot_…`` also save it.
"""

from tactile.study.plots.adjusted import adjusted_figure as adjusted_figure
from tactile.study.plots.adjusted import plot_adjusted as plot_adjusted
from tactile.study.plots.studies import criterion_figure as criterion_figure
from tactile.study.plots.studies import length_map_figure as length_map_figure
from tactile.study.plots.studies import pareto_figure as pareto_figure
from tactile.study.plots.studies import plot_criterion as plot_criterion
from tactile.study.plots.studies import plot_length_map as plot_length_map
from tactile.study.plots.studies import plot_pareto as plot_pareto
from tactile.study.plots.studies import plot_response_phase as plot_response_phase
from tactile.study.plots.studies import plot_tolerance as plot_tolerance
from tactile.study.plots.studies import response_phase_figure as response_phase_figure
from tactile.study.plots.studies import tolerance_figure as tolerance_figure
