#!/bin/sh
# The pendulum without gusts, in a shell script: one line of JSON in, a CSV file, one line out.
while read -r line; do
  printf '%s\n' "$line" | awk -F '[][{}:," ]+' '{
    angle = $6; rate = $8; horizon = $14; limit = $17; path = $26
    for (k = 0; k <= int(horizon / 0.01 + 0.5); k++) {
      printf "%.17g,%.17g,%.17g\n", k * 0.01, angle, rate > path
      torque = -25 * angle - 7 * rate
      torque = torque > limit ? limit : torque < -limit ? -limit : torque
      rate += 0.01 * (9.81 * sin(angle) + torque)
      angle += 0.01 * rate
    }
  }' && echo '{"done": true}' || echo '{"error": "awk failed"}'
done
