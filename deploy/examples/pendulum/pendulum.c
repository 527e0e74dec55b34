/* A pendulum under a torque that is limited: does the controller hold it up? One rollout for each line on stdin. */
#include <math.h>
#include <stdio.h>

int main(void) {
    double angle, rate, horizon;
    unsigned long long seed;
    int request; char path[1024];
    while (scanf(" {\"request\": %d, \"start\": {\"angle\": %lf, \"rate\": %lf}, \"seed\": %llu, \"variant\": \"nominal\", "
                 "\"horizon\": %lf, \"options\": {}, \"worker\": {%*[^}]}, \"path\": \"%1023[^\"]\"}",
                 &request, &angle, &rate, &seed, &horizon, path) == 6) {
        FILE *samples = fopen(path, "w");
        if (!samples) return 1; /* which fails the rollout */
        for (int k = 0; k <= horizon / 0.01 + 0.5; k++) {
            fprintf(samples, "%.17g,%.17g\n", angle, rate);
            seed = seed * 6364136223846793005ULL + 1442695040888963407ULL; /* for a gust, uniform in +-0.5 */
            double gust = (double)(seed >> 11) / 9007199254740992.0 - 0.5;
            double torque = fmax(-6.0, fmin(6.0, -25.0 * angle - 7.0 * rate));
            rate += 0.01 * (9.81 * sin(angle) + torque + gust);
            angle += 0.01 * rate;
        }
        fclose(samples);
        printf("{\"request\": %d, \"done\": true}\n", request);
        fflush(stdout);
    }
}
