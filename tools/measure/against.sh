#!/bin/sh
# Compares the CPU time (user + sys) and the peak memory of two builds of evcal: the same command by each in turn, five pairs, and the
# median of the ratios NEW / OLD. The arguments after the programs are evcal's; OUT stands for an output folder that does not exist.
#   sh tools/measure/against.sh OLD NEW calibrate RECORDING --board BOARD -o OUT
#   PAIRS=3 sh tools/measure/against.sh OLD NEW check RECORDING --board BOARD
set -eu
[ $# -ge 3 ] || { echo "against: give two programs and a command" >&2; exit 2; }
exec python3 - "${PAIRS:-5}" "$@" <<'PYTHON'
import os
import statistics
import sys
import tempfile

pairs, programs, arguments = int(sys.argv[1]), sys.argv[2:4], sys.argv[4:]


def run(program, folder):
    """Returns the exit status, CPU seconds and MB of one run."""
    command = [program] + [os.path.join(folder, "out") if one == "OUT" else one for one in arguments]
    pid = os.fork()
    if pid == 0:
        null = os.open(os.devnull, os.O_RDWR)
        for stream in range(3):
            os.dup2(null, stream)
        os.execvp(program, command)
    _, status, usage = os.wait4(pid, 0)
    return os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


rows = []
for pair in range(pairs):
    row = []
    for program in programs:
        with tempfile.TemporaryDirectory() as folder:
            row.append(run(program, folder))
    rows.append(row)
    (_, old, old_memory), (_, new, new_memory) = row
    print(f"pair {pair + 1}: {old:.2f} -> {new:.2f} CPU s, {old_memory:.0f} -> {new_memory:.0f} MB")
print(f"exit status: {sorted({row[0][0] for row in rows})} -> {sorted({row[1][0] for row in rows})}")
for name, place in (("CPU time", 1), ("memory", 2)):
    old, new = (statistics.median(row[side][place] for row in rows) for side in (0, 1))
    ratio = statistics.median(row[1][place] / row[0][place] for row in rows)
    print(f"{name}: median {old:.2f} -> {new:.2f}, ratio {ratio:.3f}")
PYTHON
