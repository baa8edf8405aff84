"""Benchmarks of every figure that the project promises: accuracy, fidelity, speed and memory.

Each benchmark is a function that yields figures. A figure has a goal, or none if it only serves as
a comparison. Where another library does the same work, it is measured in the same run. BLAS is
limited to one thread. ``python -m benchmarks`` runs the benchmarks.
"""

from functools import partial
from itertools import chain

from benchmarks import crowd, deaths, estop, links
from benchmarks.actuator import measure_matrix, measure_plant, measure_response
from benchmarks.budgets import measure_budgets
from benchmarks.clock import measure_clock
from benchmarks.cluster import measure_dask, measure_million
from benchmarks.coupling import measure_couplings
from benchmarks.distinct import measure_distinct
from benchmarks.faults import measure_faults
from benchmarks.finger import measure_finger
from benchmarks.firmware import measure_firmware
from benchmarks.fit import measure_fit
from benchmarks.friction import measure_friction
from benchmarks.fuzz import measure_fuzz
from benchmarks.fuzz_server import measure_fuzz_server
from benchmarks.jack import measure_jack, measure_jack_long
from benchmarks.latency import measure_latency, measure_latency_long
from benchmarks.library import measure_library
from benchmarks.lsl import measure_lsl
from benchmarks.maps import measure_maps
from benchmarks.onsets import measure_onsets, measure_onsets_long
from benchmarks.optimize import measure_optimize
from benchmarks.page import measure_page
from benchmarks.page_fuzz import measure_page_fuzz
from benchmarks.page_position import measure_page_position
from benchmarks.protocol import measure_protocol
from benchmarks.realism import measure_realism
from benchmarks.rendering import measure_bands, measure_grating, measure_place, measure_wood
from benchmarks.ribs import measure_ribs
from benchmarks.sensing import measure_sensing
from benchmarks.sensing_guard import measure_guard
from benchmarks.session import measure_session
from benchmarks.spectrum import measure_spectrum
from benchmarks.startup import measure_startup
from benchmarks.study import measure_study
from benchmarks.tactile_frames import measure_tactile_frames, measure_tactile_frames_long
from benchmarks.tracking import measure_tracking
from benchmarks.travel import measure_travel
from benchmarks.waves import measure_waves
from tactile.bench import Benchmark
from tactile.bench.resources import measure_jitter, measure_memory, measure_speed

BENCHMARKS: dict[str, Benchmark] = {
    "matrix": measure_matrix,
    "response": measure_response,
    "grating": measure_grating,
    "wood": measure_wood,
    "friction": measure_friction,
    "bands": measure_bands,
    "place": measure_place,
    "maps": measure_maps,
    "speed": measure_speed,
    "startup": measure_startup,
    "spectrum": measure_spectrum,
    "plant": measure_plant,
    "study": measure_study,
    "memory": measure_memory,
    "jitter": measure_jitter,
    "clock": measure_clock,
    "protocol": measure_protocol,
    "faults": measure_faults,
    "budgets": measure_budgets,
    "firmware": measure_firmware,
    "links": links.measure_links,
    "fit": lambda: chain(measure_fit(), measure_ribs()),
    "finger": measure_finger,
    "tracking": measure_tracking,
    "travel": measure_travel,
    "latency": measure_latency,
    "tactile-frames": measure_tactile_frames,
    "onsets": measure_onsets,
    "lsl": measure_lsl,
    "jack": measure_jack,
    "page": measure_page,
    "page-position": measure_page_position,
    "waves": measure_waves,
    "crowd": crowd.measure_crowd,
    "optimize": measure_optimize,
    "deaths": deaths.measure_deaths,
    "estop": estop.measure_estop,
}
"""Short benchmarks, by name."""
LONG: dict[str, Benchmark] = {
    "soak": partial(measure_memory, 600),
    "fuzz": measure_fuzz,
    "fuzz-server": measure_fuzz_server,
    "page-fuzz": measure_page_fuzz,
    "streams": partial(links.measure_streams, links.LONG),
    "latency-long": measure_latency_long,
    "tactile-frames-long": measure_tactile_frames_long,
    "onsets-long": measure_onsets_long,
    "jack-long": measure_jack_long,
    "deaths-long": partial(deaths.measure_deaths, deaths.LONG),
    "estop-long": partial(estop.measure_estop, estop.LONG),
    "estop-play": estop.measure_estop_play,
    "sensing": measure_sensing,
    "guard": measure_guard,
    "coupling": measure_couplings,
    "session": measure_session,
    "hour": partial(crowd.measure_crowd, crowd.SOAK),
    "crowd-long": partial(crowd.measure_crowd, crowd.LONG),
    "distinct": measure_distinct,
    "library": measure_library,
    "realism": measure_realism,
    "dask": measure_dask,
    "million": measure_million,
}
"""Benchmarks that take minutes, by name."""
