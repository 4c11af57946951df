#!/bin/sh
# Shares the work of `simulate` and `reconstruct` among the tasks of a real Slurm array, kills some of them, submits the
# array again, and compares the bytes with those of one run. Slurm is started for this script alone, with one node.
#
# Needs slurm-wlm and munge (Debian: `apt-get install slurm-wlm`), root (slurmd asks for it), and the program.
# Usage: tests/cluster/slurm.sh [PROGRAM] [FOLDER]; exit code 0 where all bytes agree, 77 where Slurm is missing.
set -eu

program=$(realpath "${1:-target/release/ommatidia}")
work=$(realpath "${2:-$(mktemp -d)}")
for tool in slurmctld slurmd sbatch squeue scancel munged; do
    if ! PATH="$PATH:/usr/sbin" command -v "$tool" > /dev/null; then
        echo "skipped: $tool is not installed (Debian: apt-get install slurm-wlm)"
        exit 77
    fi
done
PATH="$PATH:/usr/sbin"
cd "$work"
mkdir -p slurm/state slurm/spool

# --- One node, for this run alone.
host=$(hostname -s)
cat > slurm/slurm.conf <<CONF
ClusterName=ommatidia
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
SlurmctldPort=16817
SlurmdPort=16818
AuthType=auth/munge
AuthInfo=socket=$work/slurm/munge.socket
CredType=cred/munge
StateSaveLocation=$work/slurm/state
SlurmdSpoolDir=$work/slurm/spool
SlurmctldPidFile=$work/slurm/slurmctld.pid
SlurmdPidFile=$work/slurm/slurmd.pid
SlurmctldLogFile=$work/slurm/slurmctld.log
SlurmdLogFile=$work/slurm/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
MpiDefault=none
ReturnToService=2
KillWait=1
NodeName=$host NodeAddr=127.0.0.1 CPUs=2 State=UNKNOWN
PartitionName=all Nodes=$host Default=YES MaxTime=INFINITE State=UP
CONF
export SLURM_CONF="$work/slurm/slurm.conf"
dd if=/dev/urandom of=slurm/munge.key bs=1024 count=1 2> /dev/null
chmod 600 slurm/munge.key
stop() {
    for name in slurmd slurmctld munged; do
        if [ -f "slurm/$name.pid" ]; then
            kill "$(cat "slurm/$name.pid")" 2> /dev/null || true
        fi
    done
}
trap stop EXIT
munged --force --key-file="$work/slurm/munge.key" --socket="$work/slurm/munge.socket" \
    --pid-file="$work/slurm/munged.pid" --log-file="$work/slurm/munged.log" --seed-file="$work/slurm/munge.seed"
slurmctld -c
slurmd -c
for _ in $(seq 30); do
    if sinfo -h -o %t | grep -q idle; then
        break
    fi
    sleep 1
done
sbatch --version
sinfo

# --- An instrument, its frames, and the reference: one run each, without Slurm.
# A small one: its frames take a tenth of a second each.
"$program" bench session --instrument 1 --frames 4 --seed 3 -q
"$program" calibrate session -o lab.instrument --replicates 0 -q > /dev/null
# 320 frames: each of 8 tasks has one part or two.
python=$(command -v python3) && "$python" - <<'PY'
import ast, struct
head = open("session/scene.npy", "rb").read()
length = struct.unpack("<H", head[8:10])[0]
info = ast.literal_eval(head[10:10 + length].decode())
info["shape"] = (80 * info["shape"][0],) + info["shape"][1:]
text = repr(info).encode()
text += b" " * (-(len(text) + 11) % 64) + b"\n"
open("frames.npy", "wb").write(head[:8] + struct.pack("<H", len(text)) + text + 80 * head[10 + length:])
PY
with="frames.npy --with lab.instrument --method richardson-lucy"
"$program" reconstruct $with -o one.npy -q
"$program" simulate lab.instrument -o one.pairs --count 512 --specimen beads -q > /dev/null

submit() {
    sbatch --parsable --array="$1" --cpus-per-task=1 --output="slurm/%A-%a.log" --wrap="set -e
$program simulate lab.instrument -o $2.pairs --count 512 --specimen beads --shard auto --threads 1
$program reconstruct $with -o $2.npy --shard auto --threads 1"
}
finish() {
    while squeue -h -j "$1" 2> /dev/null | grep -q .; do
        sleep 1
    done
}

# --- 1, 3 and 8 tasks; of the 8, three are killed at their work, and the array is submitted again.
for tasks in 1 3 8; do
    job=$(submit "1-$tasks" "of$tasks")
    if [ "$tasks" = 8 ]; then
        for victim in 1 2 5; do
            for _ in $(seq 600); do
                if squeue -h -t RUNNING -o %K -j "$job" | grep -qx "$victim"; then
                    break
                fi
                sleep 0.1
            done
            sleep 0.7
            scancel --signal=KILL --full "${job}_$victim" 2>&1 && echo "killed task $victim of 8"
        done
        finish "$job"
        again=$("$program" reconstruct $with -o of8.npy --shard 1/8 --json -q 2> /dev/null |
            sed 's/.*"parts_missing":\([0-9]*\).*/\1/')
        echo "after the kills: $again parts are missing"
        job=$(submit 1-8 of8)
    fi
    finish "$job"
    "$program" reconstruct $with -o "of$tasks.npy" --resume -q
done

status=0
for tasks in 1 3 8; do
    cmp one.npy "of$tasks.npy" || status=1
    diff -r one.pairs "of$tasks.pairs" || status=1
done
sha256sum one.npy of1.npy of3.npy of8.npy
for set in one.pairs of1.pairs of3.pairs of8.pairs; do
    printf '%s  %s\n' "$(cd "$set" && cat ./* | sha256sum | cut -d' ' -f1)" "$set"
done
[ $status = 0 ] && echo "the bytes of 1, 3 and 8 tasks are those of one run"
exit $status
