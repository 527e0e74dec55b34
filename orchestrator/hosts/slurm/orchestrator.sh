# Decides and records: the one job that writes the run directory. Killed, or warned of its time limit, it continues from
# its database when it is queued again.
. "$folder/common.sh"

watch() {
  if ended; then
    # The router has failed, so nothing under way can be delivered: the second of these signals ends the draining.
    kill -TERM "$child"
  elif [ -n "$warned" ] && [ "$((SECONDS - warned))" -ge 60 ]; then
    kill -TERM "$child" # it drains no longer: what is under way is simulated again
  fi
}

orchestrate() { # becomes the program, of which there is a second one when the router has moved
  if [ -e "$directory/campaign.db" ]; then
    exec "$programs/perfbound" resume "$directory" --workers 0 --drain "${tls[@]}" "$@"
  fi
  exec "$programs/perfbound" orchestrate "$campaign" --out "$directory" --drain "${tls[@]}" "$@"
}

held() { # a file or folder is locked; 9 is neither of the program nor of a fault
  flock --nonblock --shared --conflict-exit-code 9 "$1" true
  [ "$?" -eq 9 ]
}

# Whether another orchestrator has the run directory: that of this job before, on a node that Slurm has lost sight of.
# A lock of the folder is one of this node alone where NFS shares it; that of the file is one of all nodes.
locked() {
  { [ -d "$directory" ] && held "$directory"; } ||
    { [ -f "$directory/orchestrator.lock" ] && held "$directory/orchestrator.lock"; }
}

while :; do
  if locked; then
    echo "$directory: another orchestrator is running this campaign; waiting for its end" >&2
    while locked && [ -z "$warned" ]; do sleep 1; done
  fi
  ! ended || exit 0
  connected orchestrate
  code=$?
  case "$code" in 0 | 130 | 143) break ;; esac
  locked || break # it may finish the campaign, or end as well: to find it is no failure
done
if ended && [ "$code" -ne 0 ]; then
  echo "the router of this campaign has failed; the output of its job says why" >&2
  exit "$code"
fi
# Warned, it was asked to end: whatever signal it ended by, it continues when this job runs again.
if [ -n "$warned" ] && [ "$code" -gt 128 ]; then
  again
  exit "$code"
fi
conclude "$code"
exit "$code"
