"""Real devices: force sensors and motion platforms, connected by their protocols, on the loop's
side and on the device's.

Read :mod:`~hiltestbed.devices.interface` first: the interface of a device. Then
:mod:`~hiltestbed.devices.table`, which finds a protocol by the scheme of a URL, and any protocol,
one module each: rdt, rsi, rtde, udp, shm. In addition, :mod:`~hiltestbed.devices.watch` monitors a
connection once per cycle, :mod:`~hiltestbed.devices.pace` paces the cycle and compares model time
with the wall clock, :mod:`~hiltestbed.devices.realtime` prepares the process;
:mod:`~hiltestbed.devices.recorder` and :mod:`~hiltestbed.devices.watchdog` are processes beside it.

Nothing here is safety-rated: an emergency stop, limits and speeds that protect people belong in the
devices' own certified controllers.
"""
