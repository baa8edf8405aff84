"""All commands; to import them is to add them to the application."""

from tactile.cli import (  # noqa: F401
    adjust_commands,
    convert_commands,
    fit_commands,
    link_commands,
    material_commands,
    measure_commands,
    optimize_commands,
    paper_commands,
    play_commands,
    relief_commands,
    show_commands,
    stop_commands,
    strength_commands,
    study_commands,
    texture_commands,
)
