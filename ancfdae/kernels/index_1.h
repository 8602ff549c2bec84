/* Accelerations and multipliers of the index-1 equations, and states moved onto the constraints
 * (`integrators/problem.py`), in real numbers.
 *
 * A state is q above its n_b design derivatives, then v likewise: (2, 1 + n_b, n), or (2, 1, n).
 * `Index1` has the algorithm once, for lists of operations (`Index1System`) and for the formulas of
 * a scene (`scene_accelerations.h`).
 *
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

int all_finite(const double *x, Size count)
{
    double sum = 0;
    for (Size i = 0; i < count; i++)
        sum += 0 * x[i];
    return sum == 0;
}

/* Finds (a, lam) above its derivatives, (rows, n + m), and moves a state onto the constraints. */
struct Accelerations {
    Size rows, n, m;
    virtual ~Accelerations() = default;
    /* Times of the next states, ascending: laws are evaluated at all times in one call. */
    virtual void expect(Size, const double *) {}
    virtual int solved(double t, const double *state, double *out) = 0;
    virtual int projected(double t, double *state) = 0;
};

/* The same by formulas; counts the matrices that are factorised. */
struct Index1 : Accelerations {
    Size factorisations = 0;
    double *right; /* Room for `index_1_room` numbers. */

    Size index_1_room() const { return rows * (n + m); }
    /* Factorises the matrix at a state: SOLVED, NOT_FINITE or SINGULAR. */
    virtual int factored(double t, const double *state) = 0;
    /* Solves in place for right sides, (count, n + m). */
    virtual int solve(Size count, double *x) = 0;
    /* Q and gamma at the state where the matrix was factorised. */
    virtual void sides(double t, const double *state, double *x) = 0;
    /* Right sides of the derivatives of x = (a, lam), (rows - 1, n + m). */
    virtual void changes(double t, const double *state, const double *x, double *out) = 0;
    /* Phi or dPhi/dt of a state, or their derivatives, row i from `out` + i (n + m) on. */
    virtual void defects(bool speed, bool derivatives, double t, const double *state,
                         double *out) = 0;

    /* (a, lam) of a state, and its derivatives: (rows, n + m). */
    int solved(double t, const double *state, double *out) override
    {
        Size size = n + m;
        if (!all_finite(state, 2 * rows * n))
            return NOT_FINITE;
        int trouble = factored(t, state);
        if (trouble)
            return trouble;
        sides(t, state, out);
        trouble = solve(1, out);
        if (!trouble && rows > 1) {
            changes(t, state, out, out + size);
            trouble = solve(rows - 1, out + size);
        }
        return trouble ? trouble : all_finite(out, rows * size) ? (int)SOLVED : (int)NOT_FINITE;
    }

    /* Moves a state onto the constraints, in place: by the smallest changes of q, then of v, then of
     * the derivatives of each. */
    int projected(double t, double *state) override
    {
        Size size = n + m;
        if (!all_finite(state, 2 * rows * n))
            return NOT_FINITE;
        if (m == 0)
            return SOLVED;
        int trouble = factored(t, state);
        for (int step = 0; !trouble && step < (rows > 1 ? 4 : 2); step++) {
            Size speed = step % 2, derivatives = step / 2, count = derivatives ? rows - 1 : 1;
            double *part = state + (speed * rows + derivatives) * n;
            memset(right, 0, (size_t)(count * size) * sizeof *right);
            defects(speed, derivatives, t, state, right + n);
            trouble = solve(count, right);
            for (Size i = 0; i < count; i++)
                for (Size j = 0; j < n; j++)
                    part[i * n + j] -= right[i * size + j];
        }
        return trouble;
    }
};

struct Index1System {
    const Operations *lists[INDEX_1_LISTS];
    const double *constants[INDEX_1_LISTS], *b, *scale;
    Size n, m, n_b, rows;
    double *numbers, *K;
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

Size index_1_lists_room(const Index1System *s)
{
    Size most = 0, size = s->n + s->m;
    for (int i = 0; i < INDEX_1_LISTS; i++)
        if (s->lists[i] && s->lists[i]->n_numbers > most)
            most = s->lists[i]->n_numbers;
    return most * LIST_LANES + size * size;
}

/* Outputs of a list at t and a state, and of SIDES at x = (a, lam), in columns `lanes` apart; changes
 * are derivatives from `first` on. */
const double *index_1_evaluated(const Index1System *s, int which, double t, const double *state,
                                const double *x, Size first, Size lanes)
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
        SHARED(n + s->m, x[j])
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

/* Forms the scaled matrix at a state, column by column, and its factors L U with rows exchanged; the
 * diagonal of U is inverted. */
int index_1_factored(const Index1System *s, double t, const double *state)
{
    Size n = s->n, size = n + s->m;
    const int32_t *out = s->lists[MATRIX]->outputs;
    const double *numbers = index_1_evaluated(s, MATRIX, t, state, nullptr, 0, 1), *d = s->scale;
    double *K = s->K, largest = 0, sum = 0;
    for (Size i = 0; i < n; i++)
        for (Size j = 0; j < n; j++)
            K[j * size + i] = numbers[*out++] * d[i] * d[j];
    for (Size i = n; i < size; i++) {
        for (Size j = 0; j < n; j++)
            K[j * size + i] = K[i * size + j] = numbers[*out++] * d[i] * d[j];
        memset(K + i * size + n, 0, (size_t)s->m * sizeof *K);
    }
    for (Size i = 0; i < size * size; i++) {
        double entry = fabs(K[i]);
        sum += 0 * entry, largest = entry > largest ? entry : largest;
    }
    if (sum != 0)
        return NOT_FINITE;
    for (Size k = 0; k < size; k++) {
        double *__restrict column = K + k * size;
        Size best = k;
        for (Size i = k + 1; i < size; i++)
            if (fabs(column[i]) > fabs(column[best]))
                best = i;
        s->exchanged[k] = (int)best;
        if (!(fabs(column[best]) > ROUND_OFF * largest))
            return SINGULAR;
        for (Size j = 0; best != k && j < size; j++)
            std::swap(K[j * size + k], K[j * size + best]);
        double inverse = column[k] = 1 / column[k];
        for (Size i = k + 1; i < size; i++)
            column[i] *= inverse;
        for (Size j = k + 1; j < size; j++) {
            double *__restrict to = K + j * size, factor = to[k];
            for (Size i = k + 1; factor != 0 && i < size; i++)
                to[i] -= column[i] * factor;
        }
    }
    return SOLVED;
}

/* Solves in place for a right side of the unscaled equations. */
void index_1_solved(const Index1System *s, double *__restrict x)
{
    Size size = s->n + s->m;
    const double *__restrict K = s->K;
    for (Size i = 0; i < size; i++)
        x[i] *= s->scale[i];
    for (Size k = 0; k < size; k++)
        std::swap(x[k], x[s->exchanged[k]]);
    for (Size k = 0; k < size; k++) {
        double known = x[k];
        for (Size i = k + 1; i < size; i++)
            x[i] -= K[k * size + i] * known;
    }
    for (Size k = size - 1; k >= 0; k--) {
        double known = x[k] *= K[k * size + k];
        for (Size i = 0; i < k; i++)
            x[i] -= K[k * size + i] * known;
    }
    for (Size i = 0; i < size; i++)
        x[i] *= s->scale[i];
}

/* Outputs of a list to rows `size` apart, of derivatives from `first` on. */
void index_1_outputs(const Index1System *s, int which, double t, const double *state,
                     const double *x, bool derivatives, double *out)
{
    Size size = s->n + s->m, count = derivatives ? s->rows - 1 : 1;
    const Operations *list = s->lists[which];
    for (Size done = 0; done < count; done += LIST_LANES) {
        Size lanes = count - done < LIST_LANES ? count - done : LIST_LANES;
        const double *numbers = index_1_evaluated(s, which, t, state, x, done, lanes);
        for (Size i = 0; i < lanes; i++)
            for (Size j = 0; j < list->n_outputs; j++)
                out[(done + i) * size + j] = numbers[list->outputs[j] * lanes + i];
    }
}

/* Accelerations by lists of operations. */
struct ListFormulas : Index1 {
    Index1System system = {};

    int factored(double t, const double *state) override
    {
        factorisations++;
        return index_1_factored(&system, t, state);
    }
    int solve(Size count, double *x) override
    {
        for (Size i = 0; i < count; i++)
            index_1_solved(&system, x + i * (n + m));
        return SOLVED;
    }
    void sides(double, const double *, double *x) override
    {
        const Operations *list = system.lists[MATRIX];
        for (Size i = 0; i < n + m; i++)
            x[i] = system.numbers[list->outputs[list->n_outputs - (n + m) + i]];
    }
    void changes(double t, const double *state, const double *x, double *out) override
    {
        index_1_outputs(&system, SIDES, t, state, x, true, out);
    }
    void defects(bool speed, bool derivatives, double t, const double *state,
                 double *out) override
    {
        int which = derivatives ? speed ? +SPEEDS : +PLACES : speed ? +SPEED : +PLACE;
        index_1_outputs(&system, which, t, state, nullptr, derivatives, out);
    }
};
