/* Forces of a load with their tangents, for one scalar type; `load_plan.h` says what it is made of. */

template <class T> struct LoadNumbers {
    const T *l, *constants, *own;
};

/* The result of an operation, and its partials. */
template <class T> INLINE T operation(int32_t op, T a, T b, T *on_a, T *on_b)
{
    T y = 0;
    *on_a = *on_b = 0;
    switch (op) {
    case ADD: y = a + b, *on_a = 1, *on_b = 1; break;
    case SUBTRACT: y = a - b, *on_a = 1, *on_b = -1; break;
    case MULTIPLY: y = a * b, *on_a = b, *on_b = a; break;
    case DIVIDE: y = a / b, *on_a = 1 / b, *on_b = -y / b; break;
    case ANGLE:
        y = angle_of(a, b), *on_a = b / (a * a + b * b), *on_b = -a / (a * a + b * b);
        break;
    case POWER: y = pow(a, b), *on_a = b * pow(a, b - 1); break;
    case NEGATE: y = -a, *on_a = -1; break;
    case SQRT: y = sqrt(a), *on_a = 0.5 / y; break;
    case EXP: y = exp(a), *on_a = y; break;
    case LOG: y = log(a), *on_a = 1 / a; break;
    case SIN: y = sin(a), *on_a = cos(a); break;
    case COS: y = cos(a), *on_a = -sin(a); break;
    case TAN: y = tan(a), *on_a = 1 + y * y; break;
    case SINH: y = sinh(a), *on_a = cosh(a); break;
    case COSH: y = cosh(a), *on_a = sinh(a); break;
    case TANH: y = tanh(a), *on_a = 1 - y * y; break;
    case ARCTAN: y = atan(a), *on_a = 1 / (1 + a * a); break;
    case SQUARE: y = a * a, *on_a = 2 * a; break;
    case RECIPROCAL: y = 1 / a, *on_a = -y * y; break;
    case POSITIVE: /* what is no number stays so */
        if (!(real_part(a) <= 0))
            y = a, *on_a = 1;
        break;
    case STEP: y = real_part(a) <= 0 ? 0 : 1; break;
    }
    return y;
}

/* Numbers of work space that a load needs, with derivatives in `lanes` directions at once. */
template <class T> INLINE Size load_work(const LoadTable *p, Size lanes)
{
    return p->n_numbers * (1 + lanes) + 2 * p->n_operations;
}

/* U = L q of a copy. */
template <class T>
INLINE void load_vectors(const LoadTable *p, Size copy, const T *l, const T *q, T *U)
{
    const int32_t *first = p->first + copy * p->n_U;
    for (Size r = 0; r < p->n_U; r++) {
        T sum = 0;
        for (int32_t e = first[r]; e < first[r + 1]; e++)
            sum += l[e] * q[p->columns[e]];
        U[r] = sum;
    }
}

/* Q += s L^T F of a copy. */
template <class T>
INLINE void load_lifted(const LoadTable *p, Size copy, const T *l, T s, const T *x, T *Q)
{
    const int32_t *first = p->first + copy * p->n_U;
    for (Size r = 0; r < p->n_U; r++) {
        T F = s * x[p->output[r]];
        for (int32_t e = first[r]; e < first[r + 1]; e++)
            Q[p->columns[e]] += l[e] * F;
    }
}

/* Numbers of a load that stand ahead of its results. */
INLINE Size load_ahead(const LoadTable *p)
{
    return 2 * p->n_U + p->n_signals + p->n_own + p->n_constants;
}

/* All numbers of a copy at q, v and signals, and partials of the operations behind them. False where
 * a gate says that the copy has no force. */
template <class T, class S>
bool load_numbers_at(const LoadTable *p, Size copy, const LoadNumbers<T> *of, const S *signals,
                     const T *q, const T *v, T *x)
{
    Size before = load_ahead(p), behind = 2 * p->n_U + p->n_signals, gate = 0;
    T *on_a = x + p->n_numbers, *on_b = on_a + p->n_operations;
    load_vectors<T>(p, copy, of->l, q, x);
    load_vectors<T>(p, copy, of->l, v, x + p->n_U);
    for (Size i = 0; i < p->n_signals; i++)
        x[2 * p->n_U + i] = signals[i];
    memcpy(x + behind, of->own + copy * p->n_own, (size_t)p->n_own * sizeof(T));
    memcpy(x + before - p->n_constants, of->constants, (size_t)p->n_constants * sizeof(T));
    for (Size k = 0; k < p->n_operations; k++) {
        x[before + k] = operation<T>(p->op[k], x[p->a[k]], x[p->b[k]], on_a + k, on_b + k);
        if (gate < p->n_gates && p->gates[gate] == k) {
            if (real_part(x[before + k]) == 0)
                return false;
            gate++;
        }
    }
    return true;
}

/* Derivatives of all numbers, rows of `lanes` directions, from derivatives of U, V and signals. */
template <class T> void load_derivatives(const LoadTable *p, Size lanes, const T *x, T *dx)
{
    Size before = load_ahead(p), held = p->n_own + p->n_constants;
    const T *on_a = x + p->n_numbers, *on_b = on_a + p->n_operations;
    memset(dx + (before - held) * lanes, 0, (size_t)(held * lanes) * sizeof(T));
    for (Size k = 0; k < p->n_operations; k++) {
        const T *da = dx + p->a[k] * lanes, *db = dx + p->b[k] * lanes;
        T *__restrict dy = dx + (before + k) * lanes, by_a = on_a[k], by_b = on_b[k];
        if (p->op[k] >= POWER)
            for (Size i = 0; i < lanes; i++)
                dy[i] = by_a * da[i];
        else
            for (Size i = 0; i < lanes; i++)
                dy[i] = by_a * da[i] + by_b * db[i];
    }
}

/* Q += s L^T F, with s the first of the factors and the signals behind it. */
template <class T, class S>
void load_force(const LoadTable *p, const LoadNumbers<T> *of, const S *factors, const T *q,
                const T *v, T *work, T *Q)
{
    for (Size copy = 0; copy < p->n_copies; copy++)
        if (load_numbers_at<T>(p, copy, of, factors + 1, q, v, work))
            load_lifted<T>(p, copy, of->l, factors[0], work, Q);
}

/* size += |s L^T F| for each copy and vector by itself. */
template <class T>
void load_sizes(const LoadTable *p, const LoadNumbers<T> *of, const T *factors, const T *q,
                const T *v, T *work, double *size)
{
    for (Size copy = 0; copy < p->n_copies; copy++) {
        const int32_t *first = p->first + copy * p->n_U;
        if (!load_numbers_at<T>(p, copy, of, factors + 1, q, v, work))
            continue;
        for (Size r = 0; r < p->n_U; r++) {
            double F = fabs(real_part(factors[0] * work[p->output[r]]));
            for (int32_t e = first[r]; e < first[r + 1]; e++)
                size[p->columns[e]] += fabs(real_part(of->l[e])) * F;
        }
    }
}

/* Q += s L^T times the derivative of F along dq, dv and, behind the first of `rates`, signals. */
template <class T>
void load_force_along(const LoadTable *p, const LoadNumbers<T> *of, const T *factors,
                      const T *rates, const T *q, const T *v, const T *dq, const T *dv, T *work,
                      T *Q)
{
    T *dx = work + load_work<T>(p, 0);
    for (Size copy = 0; copy < p->n_copies; copy++) {
        if (!load_numbers_at<T>(p, copy, of, factors + 1, q, v, work))
            continue;
        load_vectors<T>(p, copy, of->l, dq, dx);
        load_vectors<T>(p, copy, of->l, dv, dx + p->n_U);
        memcpy(dx + 2 * p->n_U, rates + 1, (size_t)p->n_signals * sizeof(T));
        load_derivatives<T>(p, 1, work, dx);
        load_lifted<T>(p, copy, of->l, factors[0], dx, Q);
    }
}

/* values += sign s L^T F_U L, or with `velocity` sign s L^T F_V L. */
template <class T, class S>
void load_tangent(const LoadTable *p, const LoadNumbers<T> *of, double sign, const S *factors,
                  const T *q, const T *v, int velocity, T *work, T *values)
{
    T s = sign * factors[0];
    Size lanes = p->n_U;
    const int32_t *first = p->first, *places = p->places;
    T *dx = work + load_work<T>(p, 0);
    for (Size copy = 0; copy < p->n_copies; copy++, first += lanes) {
        Size entries = first[lanes] - first[0];
        const int32_t *place = places;
        places += entries * entries;
        if (!load_numbers_at<T>(p, copy, of, factors + 1, q, v, work))
            continue;
        memset(dx, 0, (size_t)((2 * lanes + p->n_signals) * lanes) * sizeof(T));
        for (Size i = 0; i < lanes; i++)
            dx[(i + (velocity ? lanes : 0)) * lanes + i] = 1;
        load_derivatives<T>(p, lanes, work, dx);
        for (Size i = 0; i < lanes; i++)
            for (Size j = 0; j < lanes; j++) {
                T own = s * dx[p->output[i] * lanes + j];
                for (int32_t m = first[i]; m < first[i + 1]; m++)
                    for (int32_t o = first[j]; o < first[j + 1]; o++)
                        values[*place++] += own * of->l[m] * of->l[o];
            }
    }
}
