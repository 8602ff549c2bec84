/* Sizes of steps under error control: the digital filter of `integrators/step_control/steps.py`, which
 * states and derives it.
 */

/* Steps that may be taken back, one after another. */
enum { STEPS_BACK = 4 };
enum { STEP_PLANNED, RUN_FINISHED, STEPS_USED_UP };
/* Why no step helps, as a result of `step_judged`. */
enum { NEVER_SOLVED = -1, NEVER_ACCURATE = -2 };

/* Settings of a run, numbers that a continued run goes on with, and the last steps: the place, size and
 * error of an attempt to be repeated, and sizes and errors of accepted steps. */
struct StepFilter {
    double order, bears_jumps, t_end, most;
    double h, start, last_wish, last_ratio, memory, last_h, taken, remaining;
    double tried_at, tried_h, tried_error, count, accepted[STEPS_BACK][2];
};

/* The step aims at this error. */
#define ERROR_AIM 0.5
/* Exponent 1/b of the filter. */
#define FILTER_EXPONENT 0.25
/* Part of the largest e / h^p met that is left after a step. */
#define ERROR_MEMORY 0.95
#define MOST_GROWTH 4.0
/* The step changes by less than pi/2 of this part. */
#define STEP_CHANGE 0.2
/* A step rejected among the first RESTARTING ones restarts the run: the start is made for its step. */
#define RESTARTING 10
/* The last steps before an end change linearly, and their number is fixed, to meet it without a jump; a
 * method that bears jumps takes one. */
#define LAST_STEPS 10
/* Where a step is shorter than the attempt before by the first factor its error is smaller by the second,
 * unless it stems from the state before the step. */
#define SHORTER 0.7
#define SMALLER 0.8
/* A run ends where the step falls below this part of its length, or of the time reached. */
#define SMALLEST_STEP 1e-13
/* Times that differ by less than this part of the run are the same. */
#define SAME_INSTANT 1e-9

/* x^(1/order); the square root is exact to the last bit. */
double error_root(double x, double order) { return order == 2 ? sqrt(x) : pow(x, 1 / order); }

/* Size and end of the step from time t; controlled steps end at stops. */
int step_planned(StepFilter *f, Size n_stops, const double *stops, double t, double *h, double *end)
{
    double stop = f->t_end, least = SAME_INSTANT * f->t_end;
    if (t >= f->t_end)
        return RUN_FINISHED;
    if (f->taken >= f->most)
        return STEPS_USED_UP;
    for (Size i = 0; i < n_stops; i++)
        if (t + least < stops[i] && stops[i] < f->t_end - least && stops[i] < stop)
            stop = stops[i];
    double left = stop - t, last_steps = f->bears_jumps ? 1 : LAST_STEPS;
    if (f->remaining == 0 && left < (last_steps + 0.5) * f->h)
        f->remaining = fmax(1, ceil(left / f->h * (1 - 1e-9)));
    double count = f->remaining;
    if (count == 1)
        return *h = left, *end = stop, STEP_PLANNED;
    /* Sizes h_0 (1 + c j), j = 1 .. count, with the sum that is left. */
    *h = count > 0 ? f->last_h * (1 + 2 * (left / f->last_h - count) / (count * (count + 1))) : f->h;
    *end = t + *h;
    *h = *end - t; /* As computed from the stored times: a run over given times repeats it. */
    return STEP_PLANNED;
}

/* Go on from time point n with steps of size h that have no history. */
Size step_tried_anew(StepFilter *f, Size n, double h)
{
    f->h = f->last_h = h;
    f->last_wish = f->last_ratio = 1, f->remaining = 0;
    return n;
}

/* Choose a smaller step; near the start, which is made for its step, begin anew with it. */
Size step_rejected(StepFilter *f, Size n, double t, double h, Size why)
{
    if (h <= SMALLEST_STEP * fmax(t, f->t_end))
        return why;
    if (n > RESTARTING || f->bears_jumps)
        return step_tried_anew(f, n, h);
    f->start = fmin(h, 0.5 * f->start);
    f->memory = f->count = 0;
    return step_tried_anew(f, 0, f->start);
}

/* Judge a step of size h from time point n at time t by its error; returns the index of the time point to
 * go on from. */
Size step_judged(StepFilter *f, Size n, double t, double h, bool solved, double error)
{
    f->taken++;
    if (!solved)
        return step_rejected(f, n, t, h / 4, NEVER_SOLVED);
    bool stays = (double)n == f->tried_at && h < SHORTER * f->tried_h && error > SMALLER * f->tried_error;
    int last = (int)f->count - 1;
    if (stays && error > ERROR_AIM / 2 && last >= 0) { /* Repeat the step before with half its size. */
        f->tried_at = (double)(n - 1), f->tried_h = f->accepted[last][0];
        f->tried_error = f->accepted[last][1], f->count = last;
        return step_tried_anew(f, n - 1, 0.5 * f->tried_h);
    }
    if (!(error <= 1)) {
        f->tried_at = (double)n, f->tried_h = h, f->tried_error = error;
        double factor = error < INFINITY ? error_root(ERROR_AIM / error, f->order) : 0;
        return step_rejected(f, n, t, h * fmin(0.9, fmax(0.2, factor)), NEVER_ACCURATE);
    }
    /* What the error estimates passes through zero; without memory the step would grow far too much
     * there. */
    double power = pow(h, f->order), before = f->bears_jumps ? 0 : ERROR_MEMORY * f->memory;
    f->memory = fmax(error / power, before);
    double wish = f->memory > 0 ? error_root(ERROR_AIM / (f->memory * power), f->order) : MOST_GROWTH;
    double ratio = fmin(wish, MOST_GROWTH);
    if (!f->bears_jumps) {
        ratio = pow(wish * f->last_wish, FILTER_EXPONENT / 2) * pow(f->last_ratio, -FILTER_EXPONENT);
        ratio = 1 + STEP_CHANGE * atan((ratio - 1) / STEP_CHANGE);
    }
    f->last_wish = wish, f->last_ratio = ratio;
    f->remaining = fmax(f->remaining - 1, 0);
    f->h = h * ratio, f->last_h = h;
    if (last == STEPS_BACK - 1)
        memmove(f->accepted[0], f->accepted[1], sizeof f->accepted - sizeof f->accepted[0]);
    f->count = fmin(f->count + 1, STEPS_BACK);
    f->accepted[(int)f->count - 1][0] = h, f->accepted[(int)f->count - 1][1] = error;
    return n + 1;
}
