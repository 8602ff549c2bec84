/* Steps of any method: errors against tolerances (`integrators/step_control/contracts.py`), sizes by the
 * digital filter of `integrators/step_control/steps.py`, which states and derives it, and the loop over
 * the steps.
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

/* How steps end: after the last one, or before one that needs factors at Gauss points, whose matrix is
 * indefinite and needs a band, that no time is left for, or that is not solved: since Newton's method
 * does not converge, a residual is not finite, or a matrix is singular. Under error control also
 * before one whose error is too large however short it is, where the step before the first one is to
 * be repeated, or the run is to begin anew, and where a law has raised an error of Python. */
enum {
    ALL_TAKEN,
    NEEDS_GAUSS,
    INDEFINITE,
    OUT_OF_TIME,
    NO_CONVERGENCE,
    RESIDUAL_NOT_FINITE,
    MATRIX_SINGULAR,
    ERROR_TOO_LARGE,
    STEP_BEFORE,
    BEGIN_ANEW,
    LAW_RAISED
};

double seconds_now()
{
    std::chrono::duration<double> now = std::chrono::steady_clock::now().time_since_epoch();
    return now.count();
}

/* Tables of factors of one step, rows of joints and of loads, with (turn / 1 rad)^order. */
template <class T> struct StepTables {
    const T *of_joints, *of_loads;
    Size instants;
    double turn;
};

/* What laws say of a step from t to `end`. Without laws factors do not change. In a system of one's own
 * they are the times at fractions of the step, which begin at `start`. */
template <class T> struct StepLaws {
    double start;
    std::vector<double> fractions;
    std::vector<T> times;

    StepLaws(double at, std::vector<double> of) : start(at), fractions(of), times(of.size()) {}
    virtual ~StepLaws() = default;
    /* Whether they are known: else an error of Python is set. */
    virtual bool at(double t, double end, double h, StepTables<T> *to)
    {
        for (size_t i = 0; i < times.size(); i++)
            times[i] = start + (fractions[i] == 1 ? end : t + fractions[i] * h);
        *to = {times.data(), times.data(), (Size)times.size(), 0};
        return true;
    }
};

/* The tolerance of an error, relative and the least of each coordinate; vectors have d numbers. */
struct StepTolerance {
    Size n, d;
    double rtol;
    const double *least;
};

/* e of a defect against a tolerance, beside which the round-off `blur` is allowed; both are functions of
 * the coordinate. The size of a vector is the larger one before and after the step, counted from a place
 * (nullptr for the origin). NaN if a state is not finite. */
template <class T, class F, class G>
double error_against(const StepTolerance &tolerance, const T *before, const T *after,
                     const double *place, F defect, G blur)
{
    double sum = 0;
    for (Size i = 0; i < tolerance.n; i += tolerance.d) {
        double of_before = 0, of_after = 0;
        for (Size k = i; k < i + tolerance.d; k++) {
            double from = place ? place[k] : 0;
            double x = real_part(before[k]) - from, y = real_part(after[k]) - from;
            of_before += x * x, of_after += y * y;
        }
        double size = tolerance.rtol * sqrt(fmax(of_before, of_after) / (double)tolerance.d);
        if (!isfinite(of_before + of_after))
            return NAN;
        for (Size k = i; k < i + tolerance.d; k++) {
            double ratio = defect(k) / (size + tolerance.least[k] + blur(k));
            sum += ratio * ratio;
        }
    }
    return sqrt(sum / (double)tolerance.n);
}

/* The larger error; NaN, which no step passes, if one is. */
double larger_error(double x, double y) { return x > y || std::isnan(x) ? x : y; }

/* Steps of a method in one call, under error control by a filter, or of known sizes without it. `n` counts
 * the steps of the run, `last` is the size of the step before. Accepted steps have rows: end times and,
 * under control, numbers of the filter. `along` writes a further error of a step, as of its derivatives;
 * false if it has raised an error of Python. */
struct StepRun {
    StepFilter *filter;
    Size n_stops, n, most;
    const double *stops, *sizes, *known_ends;
    double t, last, until, error;
    double *ends;
    StepFilter *filters;
    std::function<bool(double, double, double *)> along;
    Size taken, rejected;

    virtual ~StepRun() = default;
    /* Try a step of size h to `end` after those taken, and write the state behind it and, under control,
     * e: 0, or how steps end. */
    virtual int tried(double h, double end, double *e) = 0;
};

/* Try a step: as `tried`, with errors along. */
int step_tried(StepRun *c, double h, double end)
{
    c->error = NAN;
    int ends = c->tried(h, end, &c->error);
    if (ends || !c->along)
        return ends;
    double other = 0;
    if (!c->along(h, end, &other))
        return LAW_RAISED;
    c->error = larger_error(c->error, other);
    return 0;
}

/* Go back to the step before, which is to be repeated. */
void step_before(StepRun *c, double begin, double first)
{
    c->rejected++, c->taken--, c->n--;
    c->t = c->taken ? c->ends[c->taken - 1] : begin;
    c->last = c->taken == 0   ? first
              : c->taken == 1 ? c->t - begin
                              : c->t - c->ends[c->taken - 2];
}

/* Take steps until there are `most`, the run ends, or the clock says so. */
int steps_taken(StepRun *c)
{
    double begin = c->t, first = c->last, h, end;
    while (c->taken < c->most) {
        if (!c->filter)
            h = c->sizes[c->taken], end = c->known_ends[c->taken];
        else if (step_planned(c->filter, c->n_stops, c->stops, c->t, &h, &end) != STEP_PLANNED)
            return ALL_TAKEN;
        int ends = step_tried(c, h, end);
        bool judged = c->filter && (!ends || ends == NO_CONVERGENCE || ends == RESIDUAL_NOT_FINITE);
        if (ends && !judged)
            return ends;
        Size next = judged ? step_judged(c->filter, c->n, c->t, h, !ends, c->error) : c->n + 1;
        if (next > c->n) {
            if (judged)
                c->filters[c->taken] = *c->filter;
            c->ends[c->taken++] = end;
            c->n = next, c->t = end, c->last = h;
        } else {
            c->rejected++;
            if (next < 0)
                return ends ? ends : ERROR_TOO_LARGE;
            if (next == 0 && !c->filter->bears_jumps)
                return BEGIN_ANEW;
            if (next < c->n && c->taken == 0)
                return STEP_BEFORE;
            if (next < c->n)
                step_before(c, begin, first);
        }
        if (seconds_now() > c->until)
            return OUT_OF_TIME;
    }
    return ALL_TAKEN;
}
