"""Piezo drivers on I2C that are driven without firmware: DRV2667 and BOS1921.

The amplifier's last stage runs in the host (`tactile.bus.board`); `pump` hands its volts to the
chips in bursts, as fast as their own clocks play them.
"""
