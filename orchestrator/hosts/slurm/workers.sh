# One worker of the array. It ends with the campaign; warned of its time limit, it finishes or hands back its rollout,
# and is queued again.
. "$folder/common.sh"

overdue=0
watch() {
  # The orchestrator says so, but by one message that may get lost.
  if ended && [ "$((overdue += 1))" -gt 20 ]; then kill -TERM "$child"; fi
}

! ended || exit 0
connected "$programs/perfbound-worker" --until-done "${system[@]}" "${tls[@]}"
code=$?
! ended || exit 0
# After 10 minutes without an orchestrator, whose job may be waiting in the queue: then this one does, too. One that has
# found none at its first start has failed (1).
if [ "$code" -le "$((${SLURM_RESTART_COUNT:-0} > 0))" ] && [ "$SECONDS" -ge 600 ] &&
  [ ! -e "$directory/certificate.json" ]; then
  again
fi
[ -z "$warned" ] || [ "$code" -le 128 ] || again
exit "$code"
