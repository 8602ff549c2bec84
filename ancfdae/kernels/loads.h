/* Forces of a load with their tangents, for one scalar type; `load_plan.h` says what it is made of. */

typedef struct {
    const T *l, *constants;
} NAME(load_numbers);

/* The result of an operation, and its partials. */
INLINE T NAME(operation)(npy_int32 op, T a, T b, T *on_a, T *on_b)
{
    T y = 0;
    *on_a = *on_b = 0;
    switch (op) {
    case ADD: y = a + b, *on_a = 1, *on_b = 1; break;
    case SUBTRACT: y = a - b, *on_a = 1, *on_b = -1; break;
    case MULTIPLY: y = a * b, *on_a = b, *on_b = a; break;
    case DIVIDE: y = a / b, *on_a = 1 / b, *on_b = -y / b; break;
    case ANGLE: y = ANGLE_OF(a, b), *on_a = b / (a * a + b * b), *on_b = -a / (a * a + b * b); break;
    case POWER: y = MATH(pow)(a, b), *on_a = b * MATH(pow)(a, b - 1); break;
    case NEGATE: y = -a, *on_a = -1; break;
    case SQRT: y = MATH(sqrt)(a), *on_a = 0.5 / y; break;
    case EXP: y = MATH(exp)(a), *on_a = y; break;
    case LOG: y = MATH(log)(a), *on_a = 1 / a; break;
    case SIN: y = MATH(sin)(a), *on_a = MATH(cos)(a); break;
    case COS: y = MATH(cos)(a), *on_a = -MATH(sin)(a); break;
    case TAN: y = MATH(tan)(a), *on_a = 1 + y * y; break;
    case SINH: y = MATH(sinh)(a), *on_a = MATH(cosh)(a); break;
    case COSH: y = MATH(cosh)(a), *on_a = MATH(sinh)(a); break;
    case TANH: y = MATH(tanh)(a), *on_a = 1 - y * y; break;
    case ARCTAN: y = MATH(atan)(a), *on_a = 1 / (1 + a * a); break;
    case SQUARE: y = a * a, *on_a = 2 * a; break;
    case RECIPROCAL: y = 1 / a, *on_a = -y * y; break;
    }
    return y;
}

/* Numbers of work space that a load needs, with derivatives in `lanes` directions at once. */
INLINE npy_intp NAME(load_work)(const load_plan *p, npy_intp lanes)
{
    return p->n_numbers * (1 + lanes) + 2 * p->n_operations;
}

/* U = L q. */
INLINE void NAME(load_vectors)(const load_plan *p, const T *l, const T *q, npy_intp stride, T *U)
{
    for (npy_intp r = 0; r < p->n_U; r++) {
        T sum = 0;
        for (npy_int32 e = p->first[r]; e < p->first[r + 1]; e++)
            sum += l[e] * q[p->columns[e]];
        U[r * stride] = sum;
    }
}

/* Q += s L^T F, F with a stride. */
INLINE void NAME(load_lifted)(const load_plan *p, const T *l, T s, const T *x, npy_intp stride, T *Q)
{
    for (npy_intp r = 0; r < p->n_U; r++) {
        T F = s * x[p->output[r] * stride];
        for (npy_int32 e = p->first[r]; e < p->first[r + 1]; e++)
            Q[p->columns[e]] += l[e] * F;
    }
}

/* All numbers at q and v, and partials of the operations behind them. */
static void NAME(load_numbers_at)(const load_plan *p, const NAME(load_numbers) *of, const T *q,
                                  const T *v, T *x)
{
    npy_intp before = 2 * p->n_U + p->n_constants;
    T *on_a = x + p->n_numbers, *on_b = on_a + p->n_operations;
    NAME(load_vectors)(p, of->l, q, 1, x);
    NAME(load_vectors)(p, of->l, v, 1, x + p->n_U);
    memcpy(x + 2 * p->n_U, of->constants, (size_t)p->n_constants * sizeof(T));
    for (npy_intp k = 0; k < p->n_operations; k++)
        x[before + k] = NAME(operation)(p->op[k], x[p->a[k]], x[p->b[k]], on_a + k, on_b + k);
}

/* Derivatives of all numbers, rows of `lanes` directions, from those of U and V. */
static void NAME(load_derivatives)(const load_plan *p, npy_intp lanes, const T *x, T *dx)
{
    npy_intp before = 2 * p->n_U + p->n_constants;
    const T *on_a = x + p->n_numbers, *on_b = on_a + p->n_operations;
    memset(dx + 2 * p->n_U * lanes, 0, (size_t)(p->n_constants * lanes) * sizeof(T));
    for (npy_intp k = 0; k < p->n_operations; k++) {
        const T *da = dx + p->a[k] * lanes, *db = dx + p->b[k] * lanes;
        T *restrict dy = dx + (before + k) * lanes, by_a = on_a[k], by_b = on_b[k];
        if (p->op[k] >= POWER)
            for (npy_intp i = 0; i < lanes; i++)
                dy[i] = by_a * da[i];
        else
            for (npy_intp i = 0; i < lanes; i++)
                dy[i] = by_a * da[i] + by_b * db[i];
    }
}

/* Q += s L^T F. */
static void NAME(load_force)(const load_plan *p, const NAME(load_numbers) *of, T s, const T *q,
                             const T *v, T *work, T *Q)
{
    NAME(load_numbers_at)(p, of, q, v, work);
    NAME(load_lifted)(p, of->l, s, work, 1, Q);
}

/* Q += s L^T times the derivative of F along dq and dv. */
static void NAME(load_force_along)(const load_plan *p, const NAME(load_numbers) *of, T s,
                                   const T *q, const T *v, const T *dq, const T *dv, T *work, T *Q)
{
    T *dx = work + NAME(load_work)(p, 0);
    NAME(load_numbers_at)(p, of, q, v, work);
    NAME(load_vectors)(p, of->l, dq, 1, dx);
    NAME(load_vectors)(p, of->l, dv, 1, dx + p->n_U);
    NAME(load_derivatives)(p, 1, work, dx);
    NAME(load_lifted)(p, of->l, s, dx, 1, Q);
}

/* values += s L^T F_U L, or with `velocity` s L^T F_V L. */
static void NAME(load_tangent)(const load_plan *p, const NAME(load_numbers) *of, T s, const T *q,
                               const T *v, int velocity, T *work, T *values)
{
    npy_intp lanes = p->n_U;
    const npy_int32 *place = p->places;
    T *dx = work + NAME(load_work)(p, 0);
    NAME(load_numbers_at)(p, of, q, v, work);
    memset(dx, 0, (size_t)(2 * lanes * lanes) * sizeof(T));
    for (npy_intp i = 0; i < lanes; i++)
        dx[(i + (velocity ? lanes : 0)) * lanes + i] = 1;
    NAME(load_derivatives)(p, lanes, work, dx);
    for (npy_intp i = 0; i < lanes; i++)
        for (npy_intp j = 0; j < lanes; j++) {
            T own = s * dx[p->output[i] * lanes + j];
            for (npy_int32 m = p->first[i]; m < p->first[i + 1]; m++)
                for (npy_int32 o = p->first[j]; o < p->first[j + 1]; o++)
                    values[*place++] += own * of->l[m] * of->l[o];
        }
}
