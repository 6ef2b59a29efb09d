#!/bin/sh
# A million robots on a Slurm cluster, as an array of 1,000 jobs.
#
#   sbatch examples/cluster/slurm.sh
#   spherecal-lab worlds --merge --rows parquet --out study      # after the last job
#
# A job that is preempted or runs out of time is requeued, and continues where it was stopped: each
# robot is in the file of its shard as soon as it is done. STUDY is a folder that all nodes see.
#SBATCH --job-name=spherecal
#SBATCH --array=1-1000
#SBATCH --cpus-per-task=8
#SBATCH --mem=4G
#SBATCH --time=04:00:00
#SBATCH --requeue
set -eu

study=${STUDY:-study}
robots=${ROBOTS:-200000}   # in each of five worlds

# Threads: those that Slurm gives, not those that the node has.
export RAYON_NUM_THREADS="${SLURM_CPUS_PER_TASK:-1}"
exec spherecal-lab worlds --world W0 --world W1 --world W2 --world W3 --world W4 \
    --estimator nominal --estimator sphere --poses "${POSES:-150}" --seeds "$robots" \
    --shard "$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT" --out "$study"
