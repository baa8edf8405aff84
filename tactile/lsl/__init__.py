"""The bridge to the Lab Streaming Layer (LSL): what a display does, as streams for recorders.

`Bridge` is a client of the server. It offers the finger, the commanded shear, the drive and markers
of one display as LSL streams, and plays effects when markers of another stream arrive. It needs the
library pylsl, which is loaded when a bridge is made.
"""

from tactile.lsl.bridge import Bridge as Bridge
from tactile.lsl.bridge import BridgeSummary as BridgeSummary
from tactile.lsl.settings import BridgeSettings as BridgeSettings
