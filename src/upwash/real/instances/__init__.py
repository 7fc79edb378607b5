"""Service instances: each service runs in a process, a sandbox or a container of its own.

The laws:
- An instance hears its program over one control line (`control`), and ends when that line ends, however it ended.
- A service may be hostile, and shares a process with the instance's end of the line (`instance`). The program's
  end (`instance_control`) bounds its reports, and accepts only possible ones.
- A start leaves either a ready instance or nothing. The end of an instance ends all that it started.

`runtime` starts processes, in a `sandbox` (bubblewrap, `limits`, `syscalls`) if there is one. `containers` has
what all engines share. `docker/` starts containers without a network, whose process 1 (`docker.inside`) gets its
sockets from this program. `lxd/` starts containers with an address, whose process 1 (`lxd.init`) passes the
control line on over TLS. `local_instance` is what processes and Docker's containers share. `foreign` runs programs
in other languages.

What is ugly: a class hierarchy three deep (`ControlledInstance`, `LocalInstance`, `DockerInstance`), since
freezing, sockets and containers combine in three of four ways. LXD's containers live on after their daemon, so
they have a second life cycle in `lxd.runtime` that the others lack.
"""
