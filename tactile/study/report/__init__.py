"""Reports of design studies: a single HTML file with all its content, to read, print and send.

A report is a list of `Section`, from which `write_report` makes a file (`page`). `study_report` and
`front_report` make the sections of a study and of a Pareto front (`studies`). `write_paper` makes a
folder with all figures and claims of the paper that this project began with (`paper_folder`).
"""

from tactile.study.report.page import Picture as Picture
from tactile.study.report.page import Section as Section
from tactile.study.report.page import Table as Table
from tactile.study.report.page import check_report as check_report
from tactile.study.report.page import write_report as write_report
from tactile.study.report.paper_folder import write_paper as write_paper
from tactile.study.report.studies import front_report as front_report
from tactile.study.report.studies import study_report as study_report
