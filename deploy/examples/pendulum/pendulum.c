/* A pendulum under a torque that is limited: does the controller hold it up? One rollout for each line on stdin. */
#include <math.h>
#include <stdio.h>

static double limited(double torque, double limit) { return fmax(-limit, fmin(limit, torque)); }

static int simulate(double angle, double rate, unsigned long long seed, double horizon, double limit, const char *path) {
    const double step = 0.01;
    FILE *file = fopen(path, "wb");
    if (!file) return 0;
    for (int k = 0; k <= (int)(horizon / step + 0.5); k++) {
        double sample[2] = {angle, rate};
        fwrite(sample, sizeof sample, 1, file);
        seed = seed * 6364136223846793005ULL + 1442695040888963407ULL; /* a gust, uniform in +-0.5 */
        double gust = (double)(seed >> 11) / 9007199254740992.0 - 0.5;
        double torque = limited(-25.0 * angle - 7.0 * rate, limit);
        rate += step * (9.81 * sin(angle) + torque + gust);
        angle += step * rate;
    }
    return fclose(file) == 0;
}

int main(void) {
    char line[4096], path[1024];
    while (fgets(line, sizeof line, stdin)) {
        double angle, rate, horizon, limit;
        unsigned long long seed;
        int found = sscanf(line,
            "{\"start\": {\"angle\": %lf, \"rate\": %lf}, \"seed\": %llu, \"variant\": \"nominal\", \"horizon\": %lf, "
            "\"options\": {\"limit\": %lf}, \"path\": \"%1023[^\"]\"}",
            &angle, &rate, &seed, &horizon, &limit, path);
        if (found == 6 && simulate(angle, rate, seed, horizon, limit, path)) puts("{\"done\": true}");
        else puts("{\"error\": \"the line or the file of the samples cannot be used\"}");
        fflush(stdout);
    }
    return 0;
}
