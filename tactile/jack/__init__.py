"""The display as a sound card: what JACK plays into its ports becomes the shear of its contactors.

`SoundCard` is a client of the server and, by a process of its own, of JACK. It needs the library
JACK-Client and libjack, which are loaded when a sound card is made.
"""

from tactile.jack.card_summary import SoundCardSummary as SoundCardSummary
from tactile.jack.meters import Meters as Meters
from tactile.jack.settings import SoundCardSettings as SoundCardSettings
from tactile.jack.sound_card import SoundCard as SoundCard
