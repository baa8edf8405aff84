"""Figures for files: what the bimorph can do, what was played. The only room of matplotlib.

`response_figure` and `played_figure` draw, `plot_response` and `plot_played` also save.
"""

from tactile.plots.played_plots import Played as Played
from tactile.plots.played_plots import played_figure as played_figure
from tactile.plots.played_plots import plot_played as plot_played
from tactile.plots.response_plots import plot_response as plot_response
from tactile.plots.response_plots import response_figure as response_figure
