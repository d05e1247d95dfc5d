"""A Slurm of two one-processor nodes on this machine, for trials: munged, slurmctld and slurmd from Debian's packages.

No cgroups, no accounting, everything on the loopback device; for root alone. `Slurm.installed()` says whether it can be had.
"""

import os
import pathlib
import re
import shutil
import signal
import socket
import subprocess
import time

PACKAGES = ["munge", "slurmctld", "slurmd", "slurm-client", "slurm-wlm-basic-plugins"]
PROGRAMS = ["munged", "slurmctld", "slurmd", "sbatch", "squeue", "scancel", "scontrol", "sinfo"]

CONFIGURATION = """\
ClusterName=trial
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={port}
CommunicationParameters=NoInAddrAny,NoCtldInAddrAny
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={socket}
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool-%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd-%n.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd-%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
MpiDefault=none
SwitchType=switch/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerType=sched/backfill
SchedulerParameters=sched_min_interval=50000,batch_sched_delay=1,bf_interval=5
SlurmdParameters=config_overrides
ReturnToService=2
MinJobAge=60
FirstJobId=1
SlurmctldTimeout=10
SlurmdTimeout=10
BatchStartTimeout=10
KillWait=3
MessageTimeout=10
NodeName=node[1-{nodes}] NodeHostname={host} NodeAddr=127.0.0.1 Port=[{first}-{last}] CPUs=1 RealMemory={memory} State=UNKNOWN
PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


def installed():
    """Whether all programs are there; tries to install them. Says why not."""
    path = os.environ["PATH"]
    os.environ["PATH"] = f"{path}:/usr/sbin:/sbin"
    if os.geteuid() != 0:
        return "a Slurm for trials needs root"
    missing = [name for name in PROGRAMS if not shutil.which(name)]
    if missing:
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive", "RUNLEVEL": "1"}
        subprocess.run(["apt-get", "update", "-q"], **quiet, check=False)
        command = ["apt-get", "install", "-qy", "--no-install-recommends", *PACKAGES]
        subprocess.run(command, **quiet, env=environment, check=False)
        missing = [name for name in PROGRAMS if not shutil.which(name)]
    return f"{', '.join(missing)} cannot be installed here" if missing else None


class Slurm:
    """A cluster that lives until `stop`; only processes that it started are ended."""

    def __init__(self, folder, nodes=2, port=17310):
        self.folder, self.nodes = pathlib.Path(folder), nodes
        self.processes = {}
        self.starts = 0
        # The path of a socket must be short, and those above it no one else's.
        self.socket = f"/run/pipeline-trial-{os.getpid()}.munge"
        (self.folder / "state").mkdir(parents=True)
        self.folder.chmod(0o755)
        key = self.folder / "key"
        key.write_bytes(os.urandom(64))
        key.chmod(0o600)
        megabytes = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2**20
        fields = {"host": socket.gethostname().split(".")[0], "port": port, "first": port + 1, "last": port + nodes}
        fields |= {"folder": self.folder, "socket": self.socket, "nodes": nodes, "memory": megabytes // nodes}
        self.configuration = self.folder / "slurm.conf"
        self.configuration.write_text(CONFIGURATION.format(**fields))
        os.environ["SLURM_CONF"] = str(self.configuration)
        files = [f"--{name}-file={self.folder}/{name}" for name in ("pid", "seed", "log")]
        self.start("munged", "munged", "--foreground", "--force", f"--key-file={key}", f"--socket={self.socket}", *files)
        self.wait(lambda: os.path.exists(self.socket), "munged")
        self.start_controller()
        for node in self.names():
            self.start_node(node)
        self.wait_until_idle()

    def names(self):
        return [f"node{number + 1}" for number in range(self.nodes)]

    def start(self, name, *command):
        log = open(self.folder / f"{name}.out", "a")
        self.processes[name] = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True)

    def end(self, name, number=signal.SIGTERM):
        process = self.processes.pop(name, None)
        if process and process.poll() is None:
            process.send_signal(number)
            try:
                process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def start_controller(self):
        # One that was killed forgets the last numbers it gave. A node that has seen them end refuses them for two minutes.
        self.starts += 1
        text = re.sub("FirstJobId=.*", f"FirstJobId={1000 * self.starts}", self.configuration.read_text())
        self.configuration.write_text(text)
        self.start("slurmctld", "slurmctld", "-D", "-f", str(self.configuration))
        self.wait(lambda: subprocess.run(["scontrol", "ping"], capture_output=True).stdout.count(b" is UP"), "slurmctld")

    def start_node(self, node):
        self.start(node, "slurmd", "-D", "-N", node, "-f", str(self.configuration))

    def kill_controller(self):
        self.end("slurmctld", signal.SIGKILL)

    def kill_slurmd(self, node):
        """The daemon alone: what it has started runs on."""
        self.end(node, signal.SIGKILL)

    def kill_node(self, node):
        """The daemon and all that it has started."""
        steps = self.steps(node)
        self.end(node, signal.SIGKILL)
        for process in steps:
            try:
                os.kill(process, signal.SIGKILL)
            except ProcessLookupError:
                pass

    def steps(self, node):
        """The processes of a node's jobs, and what watches over them."""
        marks = [f"SLURMD_NODENAME={node}".encode(), f"SLURM_CONF={self.configuration}".encode()]
        found = set()
        for folder in pathlib.Path("/proc").glob("[0-9]*"):
            try:
                words = (folder / "environ").read_bytes().split(b"\0")
                if not all(mark in words for mark in marks):
                    continue
                found.add(int(folder.name))
                parent = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
                if pathlib.Path(f"/proc/{parent}/comm").read_text().strip().startswith("slurmstepd"):
                    found.add(parent)
            except (OSError, ValueError):
                pass
        return found

    def wait(self, is_so, what, seconds=60):
        deadline = time.monotonic() + seconds
        while not is_so():
            if time.monotonic() > deadline:
                self.stop()
                raise SystemExit(f"wrong: {what} is not as it should be after {seconds} s; logs in {self.folder}")
            time.sleep(0.05)

    def wait_until_idle(self):
        count = lambda: subprocess.run(["sinfo", "-hN", "-t", "idle", "-o", "%N"], capture_output=True, text=True).stdout
        self.wait(lambda: len(set(count().split())) == self.nodes, "the nodes", 120)

    def queue(self):
        return subprocess.run(["squeue", "-hr", "-o", "%i %j %T"], capture_output=True, text=True).stdout

    def repair(self):
        """All daemons run again, no job is left, and no node is set apart."""
        if "slurmctld" not in self.processes:
            self.start_controller()
        subprocess.run(["scancel", "-u", "root"], capture_output=True)
        for node in self.names():
            if node not in self.processes:
                self.start_node(node)
        self.wait(lambda: not self.queue().strip(), "the queue", 120)
        for node in self.names():
            subprocess.run(["scontrol", "update", f"NodeName={node}", "State=RESUME"], capture_output=True)
        self.wait_until_idle()

    def stop(self):
        if "slurmctld" in self.processes:
            subprocess.run(["scancel", "-u", "root"], capture_output=True)
            time.sleep(1)
        for node in self.names():
            self.kill_node(node)
        for name in list(self.processes):
            self.end(name)
        for path in pathlib.Path("/run").glob(f"pipeline-trial-{os.getpid()}.munge*"):
            path.unlink()
