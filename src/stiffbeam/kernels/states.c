/* Single steps under known forces: the states that a march in blocks passes over. */
#include "loops.h"
#include "march.h"

API void states(Int a, Int n, Int F, Int steps, Int K, const double *transition, const double *push,
                const double *forces, const double *starts, double *z, double *out)
{
    Int D = a * n;
    double *new = z + 2 * D;
    for (Int k = 0; k < steps; k++) {
        memcpy(z, k % K ? new : starts + k / K * D, (size_t)D * sizeof *z);
        memcpy(z + D, z, (size_t)D * sizeof *z);
        turn(transition, a, n, D, z, new);
        add_rows(new, D, forces + k * F, push, D, F);
        memcpy(out + (k + 1) * n, new, (size_t)n * sizeof *out);
        memcpy(out + (steps + k + 2) * n, new + n, (size_t)n * sizeof *out);
    }
}
