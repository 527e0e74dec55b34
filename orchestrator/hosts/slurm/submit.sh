# Submits the jobs of a campaign, each to start once the one before runs. Nothing of an earlier submission is left but
# the run directory, from which the campaign continues.
cd -- "$folder"
exec {lock}>.submitting
flock "$lock" # two submissions at once would see no jobs of each other
if [ -s submitted ]; then
  if ! fault=$(squeue --noheader --jobs="$(cat submitted)" 2>&1 >.queue); then
    # Slurm forgets jobs some minutes after their end. Where it does not answer at all, they may still be there.
    if [[ $fault != *"Invalid job id"* ]]; then
      echo "squeue: $fault; jobs of this campaign may be in the queue: submit it again when Slurm answers" >&2
      exit 1
    fi
  elif [ -s .queue ]; then
    echo "jobs of this campaign are in the queue already: $(cat submitted)" >&2
    exit 1
  fi
fi
rm -f -- ended endpoint submitted .queue

submitted=()
trap '[ "${#submitted[@]}" -eq 0 ] || scancel "${submitted[@]}" && rm -f -- submitted' ERR
for job in "${jobs[@]}"; do
  after=()
  [ "${#submitted[@]}" -eq 0 ] || after=("--dependency=after:${submitted[-1]}")
  id=$(sbatch --parsable "${after[@]}" "$job.sh")
  submitted+=("${id%%;*}") # behind the semicolon, the name of the cluster
  (IFS=, && echo "${submitted[*]}" >submitted) # at once: after a kill the rest is not submitted on top of these
  echo "$job ${submitted[-1]}"
done
echo "follow them with: squeue --jobs=$(cat submitted); end them with: scancel ${submitted[*]}"
