"""Runs cameras' cases in a virtual machine, with what the kernel has for that.

    python kernel_vm.py [PYTEST ARGUMENTS]

`vivid_cases.py`: V4L2 with the kernel's own virtual camera. `usb3_cases.py`: a USB3 Vision camera
of ours, plugged into the kernel's dummy USB controller. Neither can be had from outside the kernel,
and loading a module into this one takes rights and the module. So a small machine is booted with
Debian's kernel: its memory disk loads the modules and mounts this computer's file system read-only,
so that the cases run with this very Python. The processor is emulated, because KVM is not to be had
everywhere: it takes a minute.

Needs the Debian packages qemu-system-x86 busybox-static kmod cpio, and downloads (once) the kernel
with apt-get into ~/.cache/omm/vm (OMM_VM_CACHE names another folder).
"""

import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
PACKAGES = "qemu-system-x86 busybox-static kmod cpio"
TOOLS = ("qemu-system-x86_64", "busybox", "depmod", "cpio", "apt-get", "dpkg-deb")
MODULES = ("virtio_pci", "9p", "9pnet_virtio", "vivid", "dummy_hcd", "gadgetfs")
CASES = ("vivid_cases.py", "usb3_cases.py")
# One device that captures from HDMI, crops, composes and scales (that gives any size).
VIVID = "n_devs=1 node_types=0x1 num_inputs=1 input_types=0x3 ccs_cap_mode=7"
DONE = "OMM-CASES-EXIT-STATUS"
TIMEOUT_S = 280

INIT = """#!/bin/busybox sh
/bin/busybox mkdir -p /proc /sys /dev /host
/bin/busybox mount -t proc proc /proc
/bin/busybox mount -t devtmpfs dev /dev
for module in $(/bin/busybox cat /modules.order); do
  options=
  case $module in */vivid.ko*) options='@VIVID@';; esac
  /bin/busybox insmod $module $options || echo "no module $module"
done
/bin/busybox mount -t 9p -o ro,trans=virtio,version=9p2000.L,cache=loose,msize=262144 host /host
/bin/busybox mount --move /dev /host/dev
/bin/busybox mount -t proc proc /host/proc
/bin/busybox mount -t sysfs sys /host/sys
/bin/busybox mount -t tmpfs tmp /host/run
/bin/busybox mkdir -p /host/dev/shm
/bin/busybox mount -t tmpfs shm /host/dev/shm
/bin/busybox chroot /host /usr/bin/env -i PATH=/usr/bin:/bin HOME=/run TMPDIR=/run \\
  LD_LIBRARY_PATH='@LD_LIBRARY_PATH@' PYTHONPATH='@PYTHONPATH@' PYTHONDONTWRITEBYTECODE=1 \\
  _ROS_WHEELS_BOOTSTRAP_COMPLETE=1 PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 \\
  '@PYTHON@' -m pytest -p no:cacheprovider --noconftest -c /dev/null --rootdir=/run \\
  -o pythonpath= --import-mode=importlib -q @ARGUMENTS@ @CASES@
echo @DONE@=$?
/bin/busybox poweroff -f
"""


def missing() -> str:
    """What is not there that the machine needs; empty if it can run."""
    if platform.machine() != "x86_64":
        return "an x86-64 computer"
    tools = [tool for tool in TOOLS if shutil.which(tool) is None]
    return f"{', '.join(tools)} (sudo apt install {PACKAGES})" if tools else ""


def kernel_folder() -> Path:
    """The unpacked kernel package, fetched if it is not there yet."""
    default = Path.home() / ".cache" / "omm" / "vm"
    cache = Path(os.environ.get("OMM_VM_CACHE", default))
    ready = sorted(cache.glob("*/boot/vmlinuz-*"))
    if ready:
        return ready[-1].parents[1]
    cache.mkdir(parents=True, exist_ok=True)
    depends = _output(["apt-cache", "depends", "linux-image-amd64"])
    match = re.search(r"Depends: (linux-image-\S+)", depends)
    if match is None:
        raise RuntimeError("apt knows no linux-image-amd64 (apt-get update? Debian?).")
    with tempfile.TemporaryDirectory(dir=cache) as folder:
        _output(["apt-get", "download", match[1]], cwd=folder)
        unpacked = Path(folder) / "unpacked"
        (package,) = Path(folder).glob("*.deb")
        _output(["dpkg-deb", "-x", str(package), str(unpacked)])
        (modules,) = (unpacked / "lib" / "modules").iterdir()
        _output(["depmod", "-b", str(unpacked), modules.name])
        unpacked.rename(cache / match[1])
    return cache / match[1]


def run(arguments: list[str]) -> tuple[int, str]:
    """Boot, run the cases, switch off; the exit status of pytest and what was on the console."""
    kernel = kernel_folder()
    with tempfile.TemporaryDirectory() as folder:
        initrd = _make_initrd(kernel, Path(folder), arguments)
        (image,) = (kernel / "boot").glob("vmlinuz-*")
        machine = [
            "qemu-system-x86_64", "-machine", "q35", "-cpu", "max", "-m", "1500", "-smp", "1",
            "-accel", "tcg",
            "-kernel", str(image), "-initrd", str(initrd), "-nographic", "-no-reboot",
            "-append", "console=ttyS0 quiet panic=-1 tsc=unstable",
            "-virtfs", "local,path=/,mount_tag=host,security_model=none,readonly=on"
            ",multidevs=remap",
        ]  # fmt: skip
        done = subprocess.run(
            machine, stdin=subprocess.DEVNULL, capture_output=True, timeout=TIMEOUT_S
        )
    console = done.stdout.decode("utf-8", "replace").replace("\r", "")
    status = re.search(rf"{DONE}=(\d+)", console)
    return (int(status[1]) if status else -1), console + done.stderr.decode("utf-8", "replace")


def _make_initrd(kernel: Path, folder: Path, arguments: list[str]) -> Path:
    root = folder / "root"
    (root / "bin").mkdir(parents=True)
    shutil.copy(shutil.which("busybox") or "busybox", root / "bin" / "busybox")
    order = _copy_modules(kernel, root)
    (root / "modules.order").write_text("\n".join(order) + "\n")
    text = INIT
    for name, value in {
        "LD_LIBRARY_PATH": os.environ.get("LD_LIBRARY_PATH", ""),
        "PYTHONPATH": os.pathsep.join(p for p in sys.path if p),
        "PYTHON": sys.executable,
        "ARGUMENTS": " ".join(f"'{argument}'" for argument in arguments),
        "CASES": " ".join(f"'{HERE / cases}'" for cases in CASES),
        "DONE": DONE,
        "VIVID": VIVID,
    }.items():
        text = text.replace(f"@{name}@", value)
    (root / "init").write_text(text)
    (root / "init").chmod(0o755)
    initrd = folder / "initrd"
    with open(initrd, "wb") as file:
        names = "\n".join(str(p.relative_to(root)) for p in [root, *root.rglob("*")]).encode()
        subprocess.run(
            ["cpio", "--quiet", "-o", "-H", "newc"], cwd=root, input=names, stdout=file, check=True
        )
    return initrd


def _copy_modules(kernel: Path, root: Path) -> list[str]:
    """Copy the modules and what they need; their paths in the order of loading."""
    (modules,) = (kernel / "lib" / "modules").iterdir()
    order: list[str] = []
    for name in MODULES:
        needed = _output(
            ["modprobe", "-d", str(kernel), "-S", modules.name, "--show-depends", name]
        )
        for line in needed.splitlines():
            if not line.startswith("insmod "):  # built in
                continue
            path = Path(line.split()[1])
            target = root / "lib" / path.name
            if f"/lib/{path.name}" not in order:
                target.parent.mkdir(exist_ok=True)
                shutil.copy(path, target)
                order.append(f"/lib/{path.name}")
    return order


def _output(command: list[str], cwd: str | None = None) -> str:
    path = f"{os.environ['PATH']}:/usr/sbin:/sbin"
    environment = dict(os.environ, PATH=path)
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr.strip()}")
    return done.stdout


if __name__ == "__main__":
    if lacking := missing():
        sys.exit(f"Expected {lacking}.")
    result, told = run(sys.argv[1:])
    print(told)
    sys.exit(result)
