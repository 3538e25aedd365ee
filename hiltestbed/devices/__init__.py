"""Real devices: force sensors and motion platforms, by the protocols that they speak, from the loop's side and from the device's.

Read :mod:`~hiltestbed.devices.interface` first: what a device is to the loop. Then :mod:`~hiltestbed.devices.table`, which finds a protocol
by the scheme of a URL, and any protocol, one module each: rdt, rsi, rtde, udp, shm. Around them: :mod:`~hiltestbed.devices.watch` judges
a connection once a cycle, :mod:`~hiltestbed.devices.clock` paces a cycle, :mod:`~hiltestbed.devices.realtime` prepares the process,
:mod:`~hiltestbed.devices.recorder` and :mod:`~hiltestbed.devices.watchdog` are processes beside it.

Nothing here is safety-rated: an emergency stop, limits and speeds that protect people belong into the devices' own certified controllers.
"""
