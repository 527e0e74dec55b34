# Carries the messages: orchestrator and workers connect to it, and need no open port. It stores nothing, and may be
# killed and queued again while the campaign runs.
. "$folder/common.sh"

host=$(hostname)
if [ "${#tls[@]}" -gt 0 ]; then protocol=tls open=(); else protocol=tcp open=(--insecure); fi

watch() {
  if ended; then
    sleep 5 # for the last message: that the campaign is finished
    kill -TERM "$child"
  fi
}

! ended || exit 0
# On the same node at the same port, if that is possible: then all others simply connect again.
port=$(endpoint)
case "$port" in
  "$protocol/$host:"*) port=${port##*:} ;;
  *) port= ;;
esac
for _ in 1 2 3 4 5; do
  port=${port:-$((20000 + RANDOM % 10000))}
  note endpoint "$protocol/$host:$port"
  supervise "$programs/perfbound" router --listen "$protocol/0.0.0.0:$port" "${open[@]}" "${tls[@]}"
  code=$?
  [ -z "$warned" ] || break
  case "$code" in
    0 | 2 | 130 | 143) break ;;
    1) port= ;; # perhaps that of another program
  esac
done
if [ -n "$warned" ]; then
  again
elif ! ended; then
  case "$code" in
    0 | 130 | 143) ;;
    *)
      echo "no router, so the other jobs end as well; fix the cause, and submit the campaign again" >&2
      conclude "$code"
      ;;
  esac
fi
exit "$code"
