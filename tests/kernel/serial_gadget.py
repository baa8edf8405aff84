"""A serial device behind the kernel's dummy_hcd: one end is /dev/ttyACM0, the other /dev/ttyGS0."""

from contextlib import suppress
from pathlib import Path

from guest_tools import command, wait_for

CONFIGFS = Path("/sys/kernel/config")
GADGET = CONFIGFS / "usb_gadget" / "serial"
CONTROLLER = "dummy_udc.0"
ENGLISH = "strings/0x409"
HOST = Path("/dev/ttyACM0")
DEVICE = Path("/dev/ttyGS0")

ATTRIBUTES = {
    "idVendor": "0x1d6b",
    "idProduct": "0x0104",
    f"{ENGLISH}/manufacturer": "tactile",
    f"{ENGLISH}/product": "amplifier",
    f"{ENGLISH}/serialnumber": "0001",
}


class SerialGadget:
    """The device, plugged in from the start; DEVICE is there all the time."""

    def __init__(self) -> None:
        if not GADGET.parent.exists():
            command("mount", "-t", "configfs", "configfs", str(CONFIGFS))
        for name in (ENGLISH, "configs/c.1", "functions/acm.0"):
            (GADGET / name).mkdir(parents=True)
        for name, value in ATTRIBUTES.items():
            (GADGET / name).write_text(value)
        (GADGET / "configs/c.1/acm.0").symlink_to(GADGET / "functions/acm.0")
        self.plug()

    def plug(self) -> None:
        """Plug the gadget in; HOST is there afterwards."""
        (GADGET / "UDC").write_text(CONTROLLER)
        wait_for(f"{HOST} appears", HOST.exists)

    def unplug(self) -> None:
        """Pull the cable of the gadget."""
        (GADGET / "UDC").write_text("\n")

    def remove(self) -> None:
        """Take it to pieces, so that there may be another."""
        with suppress(OSError):  # it is unplugged
            self.unplug()
        (GADGET / "configs/c.1/acm.0").unlink()
        for name in ("configs/c.1", "functions/acm.0", ENGLISH, ""):
            (GADGET / name).rmdir()
