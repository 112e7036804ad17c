#!/bin/bash
#SBATCH --job-name=@NAME@
#SBATCH --array=0-@LAST@@LIMIT@
#SBATCH --cpus-per-task=@CPUS@
#SBATCH --mem=@MEMORY@G
#SBATCH --output=@LOG@
#SBATCH --open-mode=append
#SBATCH --requeue
#SBATCH --signal=B:TERM@120
@OPTIONS@
# Slurm sends TERM to this script before the time limit. The runs then write checkpoints, and the job waits in the queue again.
cd @DIRECTORY@ || exit 1
job=${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID
trap 'stopped=yes; [ -z "$runs" ] || kill -TERM "$runs"' TERM
@PROGRAM@ experiment @FILE@ --shard "$SLURM_ARRAY_TASK_ID/@COUNT@" --jobs 1 &
runs=$!
[ -z "$stopped" ] || kill -TERM "$runs"
wait "$runs"
status=$?
if [ -n "$stopped" ]; then
    # The signal ended the first wait; this one waits for the checkpoints.
    wait "$runs"
    status=$?
    # A job that somebody cancelled or requeued is in another state.
    case $(scontrol show job --oneliner "$job") in
        *" JobState=RUNNING "*) scontrol requeue "$job" ;;
    esac
fi
exit "$status"
