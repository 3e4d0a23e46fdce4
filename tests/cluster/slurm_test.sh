#!/usr/bin/env bash
# Goal: the files of deploy/slurm map a sortie on a Slurm cluster, to the same bytes as `trem run`, though a node is killed in the middle, and the
# scaler's number of workers goes up and down with the queue. Method: munged, slurmctld and two slurmd on this machine, as root, in a
# temporary folder; a simulated sortie; artefacts are streamed, nothing but keys and address is shared.
# usage: slurm_test.sh BIN_FOLDER SOURCE_FOLDER        exit code 77: skipped
set -euo pipefail
bin=$1
deploy=$2/deploy/slurm
# shellcheck source=tests/cluster/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"
for program in munged slurmctld slurmd sbatch squeue scancel sinfo python3; do
  command -v "$program" >/dev/null || skip "no $program (Debian: munge slurm-wlm)"
done
[ "$(id -u)" -eq 0 ] || skip "slurmd needs root"
chmod 755 "$work"
# Processes of Slurm's jobs here: they have this test's configuration in their environment. `of_node NAME`: those of one node.
of_node() {
  local environment
  for environment in /proc/[0-9]*/environ; do
    { tr '\0' '\n' <"$environment"; } 2>/dev/null | grep -qxE "SLURMD_NODENAME=$1" || continue
    { tr '\0' '\n' <"$environment"; } 2>/dev/null | grep -qxF "SLURM_CONF=$work/slurm.conf" || continue
    basename "$(dirname "$environment")"
  done
}
cleanup_more() {
  local pid
  scancel --user root 2>/dev/null
  for _ in $(seq 40); do
    [ -n "$(of_node '.*')" ] || break
    sleep 0.2
  done
  for pid in $(of_node '.*'); do kill -9 "$pid" 2>/dev/null; done
  if [ "$status" -ne 0 ]; then tail -n 5 "$work"/jobs/*.log; fi
}

# ---- The cluster --------------------------------------------------------------------------------------------------------------------
mkdir -p "$work"/{munge,state,spool-node1,spool-node2,jobs}
chmod 711 "$work/munge"
head -c 1024 /dev/urandom >"$work/munge/key"
chmod 400 "$work/munge/key"
start munged munged --foreground --force --key-file "$work/munge/key" --socket "$work/munge/socket" --pid-file "$work/munge/pid" \
  --log-file "$work/munge/log" --seed-file "$work/munge/seed"
wait_for 20 munged test -S "$work/munge/socket"
cat >"$work/slurm.conf" <<CONF
ClusterName=trem
SlurmctldHost=$(hostname -s)(127.0.0.1)
SlurmUser=root
SlurmdUser=root
SlurmctldPort=$(free_port)
AuthType=auth/munge
AuthInfo=socket=$work/munge/socket
CryptoType=crypto/munge
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SlurmdParameters=config_overrides
MpiDefault=none
SwitchType=switch/none
ReturnToService=2
PropagateResourceLimits=NONE
SlurmdTimeout=20
InactiveLimit=0
KillWait=5
MinJobAge=300
SchedulerParameters=batch_sched_delay=1,sched_interval=1,bf_interval=1
StateSaveLocation=$work/state
SlurmdSpoolDir=$work/spool-%n
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd-%n.pid
SlurmctldLogFile=$work/slurmctld.log
SlurmdLogFile=$work/slurmd-%n.log
NodeName=node1 NodeHostname=localhost NodeAddr=127.0.0.1 Port=$(free_port) CPUs=4 RealMemory=8000
NodeName=node2 NodeHostname=localhost NodeAddr=127.0.0.1 Port=$(free_port) CPUs=4 RealMemory=8000
PartitionName=all Nodes=node1,node2 Default=YES MaxTime=INFINITE State=UP
CONF
export SLURM_CONF=$work/slurm.conf
start slurmctld.out slurmctld -D -f "$SLURM_CONF"
declare -A node_pid
for node in node1 node2; do
  start "$node.out" slurmd -D -f "$SLURM_CONF" -N "$node"
  node_pid[$node]=$!
done
idle_nodes() { [ "$(sinfo --noheader --Node --format '%T' | grep -c -E '^(idle|mixed)$')" -eq "$1" ]; }
wait_for 60 "two idle nodes" idle_nodes 2
say "$(sinfo --version), nodes $(sinfo --noheader --Node --format '%N' | sort -u | xargs)"

# ---- A service and a job ------------------------------------------------------------------------------------------------------------
export TREM_BIN=$bin TREM_SERVICE=$work/service TREM_SOURCES=$work TREM_BIND=127.0.0.1 TREM_HOST=127.0.0.1 TREM_STREAM=1
TREM_PORT=$(free_port)
export TREM_PORT
eval "$("$deploy/setup.sh" "$TREM_SERVICE" tester)"
simulate 120 1600
alone
cd "$work/jobs"
sbatch --parsable --mem=500 "$deploy/coordinator.sbatch" >/dev/null
wait_for 60 "the coordinator" test -s "$TREM_SERVICE/endpoint"
TREM_COORDINATOR=$(cat "$TREM_SERVICE/endpoint")
export TREM_COORDINATOR
TREM_SBATCH_OPTIONS="--mem=1000" start scaler "$deploy/scaler.sh" 1 4 2
workers() { "$bin/trem" workers --json | python3 -c 'import json, sys; print(len(json.load(sys.stdin)))'; }
workers_are() { [ "$(workers)" "$1" "$2" ]; }
wait_for 60 "one worker" workers_are -eq 1
"$bin/trem" doctor --json | python3 -c '
import json, sys
for finding in json.load(sys.stdin):
    if finding["subject"] in ("connection", "Slurm scaler", "data lane", "workers") and not finding["good"]:
        sys.exit("trem doctor finds fault: %s" % finding)'
job=$("$bin/trem" submit "$work/sortie/sortie.textproto" "${settings[@]}")
wait_for 90 "three workers" workers_are -ge 3
say "idle, the scaler kept 1 worker; with a job it brought $(workers): $(squeue --noheader --format '%j %T %N' | sort | uniq -c | xargs)"

# ---- A node dies --------------------------------------------------------------------------------------------------------------------
home=$(squeue --noheader --name trem-coordinator --format %N)
victim=node1
[ "$home" != node1 ] || victim=node2
has_worker() { [ -n "$(squeue --noheader --array --name trem-worker --states R --nodelist "$victim" --format %i)" ]; }
if ! has_worker; then sbatch --parsable --mem=1000 --nodelist="$victim" --array=1 "$deploy/workers.sbatch" >/dev/null; fi
wait_for 60 "a worker on $victim" has_worker
wait_for 300 "some of the job" at_least_done "$job" 15
say "killing $victim (the coordinator is on $home) with its workers, at $(percent "$job") %"
kill -9 "${node_pid[$victim]}"
# With the daemons that would report the steps' ends.
for pid in $(of_node "$victim"); do
  parent=$(ps -o ppid= -p "$pid" | xargs) || continue
  [ "$(ps -o comm= -p "$parent")" != slurmstepd ] || kill -9 "$parent"
done
for pid in $(of_node "$victim"); do kill -9 "$pid" 2>/dev/null || true; done
[ "$("$bin/trem" status "$job" --json | python3 -c 'import json, sys; print(json.load(sys.stdin)["state"])')" = running ]
"$bin/trem" watch "$job" --quiet
"$bin/trem" fetch "$job" -o "$work/cluster.tif" --quiet
cmp "$work/alone.tif" "$work/cluster.tif"
say "the mosaic is byte-identical to that of trem run"

# ---- The queue is empty: the scaler goes down ---------------------------------------------------------------------------------------
# As after a reboot (-b): a daemon that is back at once would not have Slurm look for the jobs that died with the node.
start "$victim.again" slurmd -b -D -f "$SLURM_CONF" -N "$victim"
one_left() { [ "$(squeue --noheader --array --name trem-worker --states R,PD,CF --format %i | wc -l)" -eq 1 ] && workers_are -eq 1; }
wait_for 150 "one worker left" one_left
say "with an empty queue the scaler went down to $(workers) worker:"
grep -oE '[0-9]+ workers, [0-9]+ wanted|cancels .*' "$work/scaler.log" | uniq
say passed
