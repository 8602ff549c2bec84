/* Accelerations and multipliers from lists of operations, and states moved onto the constraints
 * (`integrators/problem.py`), in real numbers.
 *
 * A state is q above its n_b design derivatives, then v likewise: (2, 1 + n_b, n), or (2, 1, n).
 * Lists take all of their inputs in this order, changes of q, v and b last:
 *   MATRIX        t, q, v, b                      M, Phi_q, Q, gamma
 *   PLACE, SPEED  t, q, v, b                      Phi; dPhi/dt
 *   SIDES         t, q, v, a, lam, b; q, v, b     (Q - M a - Phi_q^T lam)', -(Phi'')'
 *   PLACES, SPEEDS  t, q, v, b; q, v, b           changes of Phi and dPhi/dt
 * The last three give derivatives: without these there are three lists.
 */
enum { MATRIX, PLACE, SPEED, SIDES, PLACES, SPEEDS, INDEX_1_LISTS };

/* Why there is no result. */
enum { SOLVED, NOT_FINITE, SINGULAR };

struct Index1System {
    const Operations *lists[INDEX_1_LISTS];
    const double *constants[INDEX_1_LISTS], *b, *scale;
    Size n, m, n_b, rows;
    double *numbers, *K, *x;
    int *exchanged;
};

/* Whether lists take the numbers of a system and return as many as they must. */
bool index_1_fits(const Index1System *s)
{
    static const int values[] = {MATRIX, PLACE, SPEED}, changes[] = {SIDES, PLACES, SPEEDS};
    Size n = s->n, m = s->m, n_b = s->n_b, plain = 1 + 2 * n + n_b, size = n + m;
    bool good = m >= 0;
    for (int i = 0; good && i < 3; i++) {
        const Operations *own = s->lists[values[i]], *by = s->lists[changes[i]];
        Size more = 2 * n + n_b + (i == 0 ? size : 0);
        good = own->n_inputs == plain && own->n_outputs == (i == 0 ? n * size + size : m) &&
               (!by || (by->n_inputs == plain + more && by->n_outputs == (i == 0 ? size : m)));
    }
    return good;
}

Size index_1_room(const Index1System *s)
{
    Size most = 0, size = s->n + s->m;
    for (int i = 0; i < INDEX_1_LISTS; i++)
        if (s->lists[i] && s->lists[i]->n_numbers > most)
            most = s->lists[i]->n_numbers;
    return most * LIST_LANES + size * (size + 1 + 2 * LIST_LANES);
}

/* Outputs of a list at t and a state, and what x = (a, lam) is, in columns `lanes` apart; changes
 * are derivatives from `first` on. */
const double *index_1_evaluated(const Index1System *s, int which, double t, const double *state,
                                Size first, Size lanes)
{
    const Operations *p = s->lists[which];
    Size n = s->n, n_b = s->n_b, at = 0;
    double *to = s->numbers;
    const double *q = state, *v = state + s->rows * n;
#define SHARED(count, value)                                                                       \
    for (Size j = 0; j < (count); j++)                                                             \
        for (Size i = 0; i < lanes; i++)                                                           \
            to[at++] = value;
    SHARED(1, t)
    SHARED(n, q[j])
    SHARED(n, v[j])
    if (which == SIDES) {
        SHARED(n + s->m, s->x[j])
    }
    SHARED(n_b, s->b[j])
    if (which >= SIDES) {
        SHARED(n, q[(1 + first + i) * n + j])
        SHARED(n, v[(1 + first + i) * n + j])
        SHARED(n_b, j == first + i)
    }
    for (Size j = 0; j < p->n_constants; j++)
        for (Size i = 0; i < lanes; i++)
            to[at++] = s->constants[which][j];
#undef SHARED
    list_evaluated<double>(p, lanes, s->numbers);
    return s->numbers;
}

/* Forms the scaled matrix at a state and exchanges its rows; Q and gamma go to x. */
int index_1_factored(const Index1System *s, double t, const double *state)
{
    Size n = s->n, size = n + s->m;
    const int32_t *out = s->lists[MATRIX]->outputs;
    const double *numbers = index_1_evaluated(s, MATRIX, t, state, 0, 1), *d = s->scale;
    double *K = s->K, largest = 0;
    for (Size i = 0; i < n; i++)
        for (Size j = 0; j < n; j++)
            K[i * size + j] = numbers[*out++] * d[i] * d[j];
    for (Size i = n; i < size; i++) {
        for (Size j = 0; j < n; j++)
            K[j * size + i] = K[i * size + j] = numbers[*out++] * d[i] * d[j];
        memset(K + i * size + n, 0, (size_t)s->m * sizeof *K);
    }
    for (Size i = 0; i < size; i++)
        s->x[i] = numbers[*out++];
    for (Size i = 0; i < size * size; i++) {
        if (!isfinite(K[i]))
            return NOT_FINITE;
        largest = fmax(largest, fabs(K[i]));
    }
    for (Size k = 0; k < size; k++) {
        Size best = k;
        for (Size i = k + 1; i < size; i++)
            if (fabs(K[i * size + k]) > fabs(K[best * size + k]))
                best = i;
        s->exchanged[k] = (int)best;
        if (!(fabs(K[best * size + k]) > ROUND_OFF * largest))
            return SINGULAR;
        if (best != k)
            for (Size j = 0; j < size; j++) {
                double kept = K[k * size + j];
                K[k * size + j] = K[best * size + j], K[best * size + j] = kept;
            }
        double inverse = 1 / K[k * size + k];
        for (Size i = k + 1; i < size; i++) {
            double factor = K[i * size + k] *= inverse;
            if (factor != 0)
                for (Size j = k + 1; j < size; j++)
                    K[i * size + j] -= factor * K[k * size + j];
        }
    }
    return SOLVED;
}

/* Solves in place for a right side of the unscaled equations. */
void index_1_solved(const Index1System *s, double *x)
{
    Size size = s->n + s->m;
    const double *K = s->K;
    for (Size i = 0; i < size; i++)
        x[i] *= s->scale[i];
    for (Size k = 0; k < size; k++) {
        double kept = x[k];
        x[k] = x[s->exchanged[k]], x[s->exchanged[k]] = kept;
    }
    for (Size i = 1; i < size; i++)
        for (Size j = 0; j < i; j++)
            x[i] -= K[i * size + j] * x[j];
    for (Size i = size - 1; i >= 0; i--) {
        for (Size j = i + 1; j < size; j++)
            x[i] -= K[i * size + j] * x[j];
        x[i] /= K[i * size + i];
    }
    for (Size i = 0; i < size; i++)
        x[i] *= s->scale[i];
}

int all_finite(const double *x, Size count)
{
    double sum = 0;
    for (Size i = 0; i < count; i++)
        sum += 0 * x[i];
    return sum == 0;
}

/* (a, lam) of a state, and its derivatives: (rows, n + m). */
int index_1_rows(const Index1System *s, double t, const double *state, double *out)
{
    Size size = s->n + s->m;
    if (!all_finite(state, 2 * s->rows * s->n))
        return NOT_FINITE;
    int trouble = index_1_factored(s, t, state);
    if (trouble)
        return trouble;
    index_1_solved(s, s->x);
    memcpy(out, s->x, (size_t)size * sizeof *out);
    for (Size done = 0; done < s->rows - 1; done += LIST_LANES) {
        Size lanes = s->rows - 1 - done < LIST_LANES ? s->rows - 1 - done : LIST_LANES;
        const double *numbers = index_1_evaluated(s, SIDES, t, state, done, lanes);
        for (Size i = 0; i < lanes; i++) {
            double *to = out + (1 + done + i) * size;
            for (Size j = 0; j < size; j++)
                to[j] = numbers[s->lists[SIDES]->outputs[j] * lanes + i];
            index_1_solved(s, to);
        }
    }
    return all_finite(out, s->rows * size) ? SOLVED : NOT_FINITE;
}

/* Takes from q or v, at `part` of the state, the smallest changes to which the constraints say. */
void index_1_moved(const Index1System *s, int which, const double *state, double t, Size first,
                   Size lanes, double *part)
{
    Size n = s->n, m = s->m;
    const double *numbers = index_1_evaluated(s, which, t, state, first, lanes);
    double *side = s->K + (n + m) * (n + m), *all = side + (n + m);
    for (Size i = 0; i < lanes; i++)
        for (Size j = 0; j < m; j++)
            all[i * m + j] = numbers[s->lists[which]->outputs[j] * lanes + i];
    for (Size i = 0; i < lanes; i++) {
        memset(side, 0, (size_t)n * sizeof *side);
        memcpy(side + n, all + i * m, (size_t)m * sizeof *side);
        index_1_solved(s, side);
        for (Size j = 0; j < n; j++)
            part[i * n + j] -= side[j];
    }
}

/* Moves a state onto the constraints, in place. */
int index_1_projected(const Index1System *s, double t, double *state)
{
    Size n = s->n;
    double *q = state, *v = state + s->rows * n;
    if (!all_finite(state, 2 * s->rows * n))
        return NOT_FINITE;
    if (s->m == 0)
        return SOLVED;
    int trouble = index_1_factored(s, t, state);
    if (trouble)
        return trouble;
    index_1_moved(s, PLACE, state, t, 0, 1, q);
    index_1_moved(s, SPEED, state, t, 0, 1, v);
    for (int speed = 0; speed < 2; speed++)
        for (Size done = 0; done < s->rows - 1; done += LIST_LANES) {
            Size lanes = s->rows - 1 - done < LIST_LANES ? s->rows - 1 - done : LIST_LANES;
            index_1_moved(s, speed ? SPEEDS : PLACES, state, t, done, lanes,
                          (speed ? v : q) + (1 + done) * n);
        }
    return SOLVED;
}
