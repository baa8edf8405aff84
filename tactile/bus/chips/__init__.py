"""Piezo driver chips on I2C that are used without firmware: DRV2667 and BOS1921.

The amplifier's last stage runs on the host (`tactile.bus.board`). `pump` passes its voltages to the
chips in bursts, as fast as the chips' own clocks play them.
"""
