"""Draw the picture of the length study in README.md: ``python docs/study_pictures.py``."""

from pathlib import Path

from tactile.plots import plot_length_map
from tactile.study.paper import FINGERS, over_length
from tactile.study.sweep import solve_study

HERE = Path(__file__).parent

plot_length_map(HERE / "length-study.png", solve_study(over_length(*FINGERS)))
