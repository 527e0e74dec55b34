# Read by the three jobs of a campaign. Their folder is one that all nodes share, and contains two notes:
#   endpoint   where the router listens now; the router writes it
#   ended      the exit code of the orchestrator, or of the router, once the campaign is finished or one of them has
#              failed: then every job ends

# One thread for each process: no job takes more than its one core.
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1

# The messages are sealed by a secret, or the links by certificates.
if [ -n "$secret" ]; then
  PERFBOUND_SECRET=$(cat -- "$secret") || exit 1
  export PERFBOUND_SECRET
elif [ "${#tls[@]}" -eq 0 ] && [ -z "${PERFBOUND_SECRET-}" ]; then
  echo "PERFBOUND_SECRET: not set; submit the jobs where it is" >&2
  exit 1
fi

child= warned=

# Slurm sends USR1 some time before the time limit, and to this shell alone: the program is asked to end, and the job is
# queued again. By scancel, by preemption and at the time limit the program gets TERM from Slurm, as this shell does,
# which waits for it then: a second TERM would end it at once.
trap 'warned=$SECONDS; [ -z "$child" ] || kill -TERM "$child"' USR1
trap : TERM

ended() { [ -e "$folder/ended" ]; }

endpoint() {
  if [ -n "${router-}" ]; then
    printf '%s' "$router"
  else
    cat -- "$folder/endpoint" 2>/dev/null
  fi
}

# note NAME TEXT: write a note, which others read whole or not at all. Where the disk is full they would wait for it in
# vain, or believe an older one: it is written as soon as there is room.
note() {
  until printf '%s\n' "$2" >"$folder/.$1.$$" && mv -f -- "$folder/.$1.$$" "$folder/$1"; do
    echo "$folder/$1: cannot be written; make room, it is tried again" >&2
    sleep 5
  done
}

# Whether the router has come back on another node, because its own was lost.
place=
moved() {
  local now
  now=$(endpoint)
  [ -n "$place" ] && [ -n "$now" ] && [ "$now" != "$place" ]
}

# supervise PROGRAM [ARGUMENT ...]: run it until it ends, call `watch` every second, and return its exit code.
supervise() {
  local code
  "$@" &
  child=$!
  while [ -n "$(jobs -rp)" ]; do
    if moved; then kill -KILL "$child"; fi # no message of it can arrive any more
    watch
    sleep 1
  done
  wait "$child"
  code=$?
  child=
  return "$code"
}

# connected PROGRAM [ARGUMENT ...]: supervise it with --connect and the endpoint of the router, and start it again with
# the new one when the router has moved.
connected() {
  local code
  while [ -z "$warned" ]; do
    place=$(endpoint)
    if [ -z "$place" ]; then
      ! ended || return 143
      sleep 1
      continue
    fi
    supervise "$@" --connect "$place"
    code=$?
    moved || return "$code"
  done
  return 143
}

# conclude CODE: every job of the campaign ends, unless a signal to this one ended its program.
conclude() {
  case "$1" in
    130 | 143) ;; # it is for somebody else to say when it continues
    *)
      # Killed, as this shell may be in a moment: then it is the job that was killed, and not the program for its memory.
      [ "$1" -le 128 ] || sleep 10
      note ended "$1"
      ;;
  esac
}

# again: queue this job once more, under its number; that ends it.
again() {
  scontrol requeue "${SLURM_ARRAY_JOB_ID:-$SLURM_JOB_ID}${SLURM_ARRAY_TASK_ID:+_$SLURM_ARRAY_TASK_ID}"
}
