/* Steps of DOP853 under error control for y'' = a(t, y, y') (`integrators/explicit.py`).
 *
 * A state is y above its derivatives in the design, then u = y' likewise: (2, rows, n). Stage k is
 * a table of factors, (2, 18), times the rows y, u, K_1, ..., K_16 of the step, where K are
 * accelerations; the factors carry powers of the length h of the step.
 */
enum { STEP_STAGES = 12, AFTER = 12, ALL_STAGES = 16, STEP_ROWS = 2 + ALL_STAGES };
/* Terms of the dense output, the last of which take rates of all stages. */
enum { SIMPLE_TERMS = 3, STAGE_TERMS = 4, TERMS = SIMPLE_TERMS + STAGE_TERMS };

/* Why a step is not taken, beside NOT_FINITE and SINGULAR. */
enum { ERROR_TEST = 3 };

/* Least change of a step, part of what its error asks for, and exponents of the errors now and
 * before (Soderlind's PI.4.2), times the exponent of the method; errors that count as no less. */
#define LEAST_CHANGE 0.2
#define LARGEST_CHANGE 10.0
#define SAFETY 0.95
#define ERROR_NOW 0.6
#define ERROR_BEFORE -0.2
#define NO_ERROR 1e-10
#define NO_ERROR_BEFORE 1e-4
#define METHOD_EXPONENT (-1.0 / 8)
/* Shortest step, in gaps between floating-point numbers at its begin. */
#define SHORTEST 10

/* Where a run stands: begin and end of its last step, the next length, the error, the end of the
 * step whose stages for dense output are there, and counts. */
struct StepControl {
    double t, end, h, error, dense, evaluations, projections;
};

struct ExplicitSteps {
    Accelerations *of;
    const double *factors, *errors, *nodes, *within; /* (16, 2, 18), (2, 2, 12), (16,), (4, 16) */
    double rtol;
    const double *floor, *place; /* (2, rows, n), (n,) */
    Size vector;
    double *x, *states, *out; /* (18, rows n), (16, 2, rows, n), (16, rows, n + m) */
    double *scale, *terms; /* (2, rows, n), (7, 2, rows, n) */
    StepControl *control;
};

/* Times at which states are recorded, ascending, room for these, and how many are there. */
struct RecordedStates {
    const double *t;
    Size count, done;
    double *states;
};

/* What integrals need of accepted steps: begin and end, and states and multipliers of some stages. */
struct KeptSteps {
    double *spans, *states, *lam;
    const int32_t *used;
    Size n_used;
};

void explicit_state(const ExplicitSteps *s, Size k, double h)
{
    Size count = s->of->rows * s->of->n;
    double *state = s->states + k * 2 * count;
    memset(state, 0, (size_t)(2 * count) * sizeof *state);
    for (int part = 0; part < 2; part++) {
        double *to = state + part * count;
        for (Size j = 0; j < STEP_ROWS; j++) {
            double factor = s->factors[(k * 2 + part) * STEP_ROWS + j];
            if (factor == 0)
                continue;
            factor *= j == 0 || (j == 1 && part) ? 1.0 : j == 1 || part ? h : h * h;
            const double *row = s->x + j * count;
            for (Size i = 0; i < count; i++)
                to[i] += factor * row[i];
        }
    }
}

/* Accelerations of a stage whose state is there. */
int explicit_solved(const ExplicitSteps *s, Size k, double t)
{
    Accelerations *of = s->of;
    Size n = of->n, size = n + of->m, count = of->rows * n;
    double *found = s->out + k * of->rows * size;
    const double *state = s->states + k * 2 * count;
    s->control->evaluations++;
    int trouble = all_finite(state, 2 * count) ? of->solved(t, state, found) : (int)NOT_FINITE;
    for (Size r = 0; r < of->rows; r++)
        memcpy(s->x + (2 + k) * count + r * n, found + r * size, (size_t)n * sizeof *found);
    return trouble;
}

/* Stages from a first one on of a step from t to `end`, of length h. */
int explicit_stages(const ExplicitSteps *s, double t, double h, double end, Size first, Size last)
{
    int trouble = SOLVED;
    double times[ALL_STAGES + 1];
    for (Size k = first; k < last; k++)
        times[k] = t + h * s->nodes[k];
    times[last] = end;
    s->of->expect(last + 1 - first, times + first);
    for (Size k = first; !trouble && k < last; k++) {
        explicit_state(s, k, h);
        trouble = explicit_solved(s, k, times[k]);
    }
    return trouble;
}

/* Tolerances: relative to the larger of each vector before and after the step, (2, rows, n). */
void explicit_scale(const ExplicitSteps *s)
{
    Size n = s->of->n, all = 2 * s->of->rows * n, d = s->vector;
    const double *before = s->states, *after = s->states + AFTER * all;
    for (Size at = 0; at < all; at += d) {
        double sum = 0, later = 0;
        for (Size i = at; i < at + d; i++) {
            double place = at < n ? s->place[i] : 0, x = before[i] - place, y = after[i] - place;
            sum += x * x, later += y * y;
        }
        double size = sqrt(fmax(sum, later) / (double)d);
        for (Size i = at; i < at + d; i++)
            s->scale[i] = s->floor[i] + s->rtol * size;
    }
}

/* Error of a step in tolerances: the estimate of order 5, less where the one of order 3 is large. */
double explicit_error(const ExplicitSteps *s, double h)
{
    Size count = s->of->rows * s->of->n;
    double mean[2];
    for (int of = 0; of < 2; of++) {
        double sum = 0;
        for (int part = 0; part < 2; part++) {
            const double *weights = s->errors + (of * 2 + part) * STEP_STAGES;
            const double *scale = s->scale + part * count;
            double power = part ? h : h * h;
            for (Size i = 0; i < count; i++) {
                double error = 0;
                for (Size j = 0; j < STEP_STAGES; j++)
                    error += weights[j] * s->x[(2 + j) * count + i];
                error *= power / scale[i];
                sum += error * error;
            }
        }
        mean[of] = sqrt(sum / (double)(2 * count));
    }
    double both = hypot(mean[0], 0.1 * mean[1]);
    return both > 0 ? mean[0] * (mean[0] / both) : mean[0];
}

/* Tries a step; its error is infinite where the equations fail. */
int explicit_attempt(const ExplicitSteps *s, double end, double *error)
{
    StepControl *c = s->control;
    Size all = 2 * s->of->rows * s->of->n;
    double h = end - c->t, *after = s->states + AFTER * all;
    *error = INFINITY;
    int trouble = explicit_stages(s, c->t, h, end, 1, STEP_STAGES);
    if (trouble)
        return trouble;
    explicit_state(s, AFTER, h);
    explicit_scale(s);
    double found = explicit_error(s, h);
    if (!isfinite(found))
        return NOT_FINITE;
    if (found < 1) {
        c->projections++;
        trouble = all_finite(after, all) ? s->of->projected(end, after) : (int)NOT_FINITE;
        if (!trouble)
            trouble = explicit_solved(s, AFTER, end);
        if (trouble)
            return trouble;
    }
    *error = found;
    return SOLVED;
}

/* Begins the next step where the last one ends. */
void explicit_advance(const ExplicitSteps *s)
{
    Size count = s->of->rows * s->of->n, size = s->of->rows * (s->of->n + s->of->m);
    memcpy(s->states, s->states + AFTER * 2 * count, (size_t)(2 * count) * sizeof *s->states);
    memcpy(s->x, s->states, (size_t)(2 * count) * sizeof *s->x);
    memcpy(s->x + 2 * count, s->x + (2 + AFTER) * count, (size_t)count * sizeof *s->x);
    memcpy(s->out, s->out + AFTER * size, (size_t)size * sizeof *s->out);
    s->control->t = s->control->end;
}

int explicit_step(const ExplicitSteps *s, double stop)
{
    StepControl *c = s->control;
    double largest = LARGEST_CHANGE, error;
    int trouble = ERROR_TEST;
    if (c->end > c->t)
        explicit_advance(s);
    double least = SHORTEST * (nextafter(c->t, INFINITY) - c->t);
    while (c->h >= least) {
        double end = fmin(c->t + c->h, stop), h = end - c->t;
        int failed = explicit_attempt(s, end, &error);
        if (failed)
            trouble = failed;
        if (error < 1) {
            double ratio = pow(fmax(error, NO_ERROR), ERROR_NOW) * pow(c->error, ERROR_BEFORE);
            c->h = h * fmin(largest, SAFETY * pow(ratio, METHOD_EXPONENT));
            c->error = fmax(error, NO_ERROR_BEFORE), c->end = end;
            return SOLVED;
        }
        c->h = h * fmax(LEAST_CHANGE, SAFETY * pow(error, METHOD_EXPONENT)), largest = 1;
    }
    return trouble;
}

void explicit_kept(const ExplicitSteps *s, const KeptSteps *kept, Size at)
{
    Size rows = s->of->rows, n = s->of->n, m = s->of->m, all = 2 * rows * n;
    kept->spans[2 * at] = s->control->t, kept->spans[2 * at + 1] = s->control->end;
    for (Size i = 0; i < kept->n_used; i++) {
        Size k = kept->used[i], to = at * kept->n_used + i;
        memcpy(kept->states + to * all, s->states + k * all, (size_t)all * sizeof(double));
        for (Size r = 0; r < rows; r++)
            memcpy(kept->lam + (to * rows + r) * m, s->out + (k * rows + r) * (n + m) + n,
                   (size_t)m * sizeof(double));
    }
}

/* Terms of the dense output of the last step, of order 7: y and u are those at its begin, and terms
 * times x, x (1 - x), x^2 (1 - x), ... for a part x of the step. */
int explicit_terms(const ExplicitSteps *s)
{
    StepControl *c = s->control;
    Size count = s->of->rows * s->of->n;
    double h = c->end - c->t;
    if (c->dense != c->end) {
        int trouble = explicit_stages(s, c->t, h, c->end, AFTER + 1, ALL_STAGES);
        if (trouble)
            return trouble;
        c->dense = c->end;
    }
    for (int part = 0; part < 2; part++) {
        /* Rates of y are u of the stages, rates of u accelerations. */
        const double *rates = part ? s->x + 2 * count : s->states + count;
        Size stride = part ? count : 2 * count;
        for (Size i = 0; i < count; i++) {
            double *to = s->terms + part * count + i;
            const double *from = s->states + part * count + i;
            double rise = from[AFTER * 2 * count] - from[0];
            double first = h * rates[i], last = h * rates[AFTER * stride + i];
            to[0] = rise, to[2 * count] = first - rise, to[4 * count] = 2 * rise - first - last;
            for (Size k = 0; k < STAGE_TERMS; k++) {
                double sum = 0;
                for (Size j = 0; j < ALL_STAGES; j++)
                    sum += s->within[k * ALL_STAGES + j] * rates[j * stride + i];
                to[(SIMPLE_TERMS + k) * 2 * count] = h * sum;
            }
        }
    }
    return SOLVED;
}

/* Records the states at times that the last step has passed. */
int explicit_recorded(const ExplicitSteps *s, RecordedStates *to)
{
    StepControl *c = s->control;
    bool has_terms = false;
    Size all = 2 * s->of->rows * s->of->n, behind = to->done;
    while (behind < to->count && to->t[behind] <= c->end)
        behind++;
    for (; to->done < behind; to->done++) {
        double t = to->t[to->done], x = (t - c->t) / (c->end - c->t), weight = 1;
        double *state = to->states + to->done * all;
        if (t == c->end) {
            memcpy(state, s->states + AFTER * all, (size_t)all * sizeof *state);
            continue;
        }
        int trouble = has_terms ? (int)SOLVED : explicit_terms(s);
        if (trouble)
            return trouble;
        if (!has_terms)
            s->of->expect(behind - to->done, to->t + to->done);
        has_terms = true;
        memcpy(state, s->states, (size_t)all * sizeof *state);
        for (Size k = 0; k < TERMS; k++) {
            weight *= k % 2 ? 1 - x : x;
            for (Size i = 0; i < all; i++)
                state[i] += weight * s->terms[k * all + i];
        }
        c->projections++;
        trouble = all_finite(state, all) ? s->of->projected(t, state) : (int)NOT_FINITE;
        if (trouble)
            return trouble;
    }
    return SOLVED;
}

/* Takes steps until one reaches `target` or `stop`, or there are `count`, and records states at times
 * behind them; returns why it ends. */
int explicit_march(const ExplicitSteps *s, double target, double stop, Size count,
                   const KeptSteps *kept, RecordedStates *recorded, Size *taken)
{
    *taken = 0;
    int trouble = explicit_recorded(s, recorded);
    while (!trouble && *taken < count && s->control->end < fmin(target, stop)) {
        trouble = explicit_step(s, stop);
        if (!trouble) {
            explicit_kept(s, kept, (*taken)++);
            trouble = explicit_recorded(s, recorded);
        }
    }
    return trouble;
}
