#!/bin/sh
# Runs s2mia in a pod of a Kubernetes Job. s2mia ends with status 0 after a finished run, after `s2mia stop` and after
# SIGTERM. Kubernetes sends SIGTERM to move a pod; the status is then 143, and the Job starts another pod.
trap 'moved=yes; kill -TERM "$!"' TERM
s2mia "$@" &
wait "$!"
status=$?
if [ -n "$moved" ]; then
    # The signal ended the first wait; this one waits for s2mia.
    wait "$!"
    status=143
fi
exit "$status"
