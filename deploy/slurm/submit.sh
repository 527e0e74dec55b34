#!/bin/bash
set -eu

folder=/home/ada/slurm/segway-paper
jobs=(router orchestrator workers)

# Submits the jobs of a campaign, each to start once the one before runs. Nothing of an earlier submission is left but
# the run directory, from which the campaign continues.
cd -- "$folder"
if [ -s submitted ] && [ -n "$(squeue --noheader --jobs="$(cat submitted)" 2>/dev/null)" ]; then
  echo "jobs of this campaign are in the queue already: $(cat submitted)" >&2
  exit 1
fi
rm -f -- ended endpoint submitted

submitted=()
trap '[ "${#submitted[@]}" -eq 0 ] || scancel "${submitted[@]}"' ERR
for job in "${jobs[@]}"; do
  after=()
  [ "${#submitted[@]}" -eq 0 ] || after=("--dependency=after:${submitted[-1]}")
  id=$(sbatch --parsable "${after[@]}" "$job.sh")
  submitted+=("${id%%;*}") # behind the semicolon, the name of the cluster
  echo "$job ${submitted[-1]}"
done
(IFS=, && echo "${submitted[*]}" >submitted)
echo "follow them with: squeue --jobs=$(cat submitted); end them with: scancel ${submitted[*]}"
