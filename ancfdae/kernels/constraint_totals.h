/* Total design derivatives of constraints, by complex steps of all that they are made of. */

#define IMAGINARY_STEP 0x1p-133

/* What design variables change: variable i reaches the joints number[variable[i]] to
 * number[variable[i + 1] - 1]; the entries of the k-th of these are first[k] to first[k + 1] - 1:
 * one below n_l is of L, the others are of coefficients in a part. `factors_b` are partials of the
 * factors, (n_b, orders, instants, n_parts), or NULL. */
typedef struct {
    npy_intp n_b;
    const npy_int32 *variable, *number, *first, *part, *entry;
    const double *value, *factors_b;
} constraint_partials;

/* Everything at one instant, to be moved: rows c of coefficients, l and states. */
typedef struct {
    const constraint_plan *p;
    const constraint_partials *of;
    int n;
    npy_intp k, instants;
    const double *factors, *moving;
    double complex *l, *c;
} moved_constraints;

static const double *factors_at(const moved_constraints *m, int order)
{
    return m->factors + (order * m->instants + m->k) * m->p->n_parts;
}

/* Add s times the partials in variable i to what joint `number` has, whose entries are those of k;
 * s = 0 takes them out. */
static void move_joint(const moved_constraints *m, npy_intp i, npy_intp k, double complex s)
{
    const constraint_plan *p = m->p;
    const npy_int32 *joint = p->joints + m->of->number[k] * JOINT_ITEMS;
    for (npy_int32 at = m->of->first[k]; at < m->of->first[k + 1]; at++) {
        npy_intp e = m->of->entry[at];
        if (e < p->n_l) {
            m->l[e] = creal(m->l[e]) + s * m->of->value[at];
            continue;
        }
        for (int order = 0; order <= m->n; order++) {
            double complex *c = m->c + order * p->n_c + e - p->n_l;
            double factor = factors_at(m, order)[m->of->part[at]];
            *c = s == 0 ? creal(*c) : *c + s * factor * m->of->value[at];
        }
    }
    if (!m->of->factors_b)
        return;
    for (int order = 0; order <= m->n; order++) {
        const double *own = m->of->factors_b + ((i * (m->n + 1) + order) * m->instants + m->k) * p->n_parts;
        for (npy_int32 e = joint[MOVING]; e < joint[JOINT_ITEMS + MOVING]; e++) {
            double complex *c = m->c + order * p->n_c + p->moving_at[e];
            *c = s == 0 ? creal(*c) : *c + s * own[p->moving_part[e]] * m->moving[e];
        }
    }
}

/* Coefficients at one instant, not moved; c[order] is NULL where it vanishes, whatever moves. */
static void still_coefficients(const moved_constraints *m, const constraint_numbers_real *of,
                               const double complex **c)
{
    const constraint_plan *p = m->p;
    for (int order = 0; order <= m->n; order++) {
        double complex *own = m->c + order * p->n_c;
        const double *factor = factors_at(m, order);
        c[order] = p->n_parts > 1 || factor[0] != 0 ? own : NULL;
        for (npy_intp e = 0; e < p->n_c; e++)
            own[e] = factor[0] * of->part_0[e];
        for (npy_intp e = 0; e < p->n_moving; e++)
            own[p->moving_at[e]] += factor[p->moving_part[e]] * of->moving[e];
    }
}

/* The states of a total derivative: the coordinates X[k], (instants, n_q), and lam, and with X_b
 * their derivatives, (instants, n_b, ...). */
typedef struct {
    int what, n;
    npy_intp instants;
    const double *factors, *X[ORDERS], *X_b[ORDERS], *lam, *lam_b;
} total_states;

static void moved_row(double complex *out, const double *x, const double *x_b, npy_intp size)
{
    for (npy_intp i = 0; i < size; i++)
        out[i] = x[i] + (x_b ? IMAGINARY_STEP * I * x_b[i] : 0);
}

/* Rows of out, (instants, n_b, size): the total derivatives of Phi or Phi_q^T lam of order n. A
 * joint that a variable does not reach has none where the states are held. */
static void constraint_totals(const constraint_plan *p, const constraint_numbers_real *of,
                              const constraint_partials *partials, const total_states *x,
                              double complex *work, double *out)
{
    const double complex *c[ORDERS], *Z[ORDERS];
    int n = x->n, held = !x->X_b[0];
    npy_intp size = x->what == RATE ? p->n_lam : p->n_q;
    moved_constraints m = {p, partials, n, 0, x->instants, x->factors, of->moving, work, NULL};
    m.c = m.l + p->n_l;
    double complex *z = m.c + (n + 1) * p->n_c, *lam = z + (n + 1) * p->n_q, *U = lam + p->n_lam;
    double complex *own = U + (n + 1) * p->most;
    moved_row(m.l, of->l, NULL, p->n_l);
    for (; m.k < x->instants; m.k++) {
        still_coefficients(&m, of, c);
        for (npy_intp i = 0; i < partials->n_b; i++, out += size) {
            npy_intp row = m.k * partials->n_b + i;
            for (int k = 0; k <= n && (i == 0 || !held); k++) {
                Z[k] = z + k * p->n_q;
                moved_row(z + k * p->n_q, x->X[k] + m.k * p->n_q,
                          held ? NULL : x->X_b[k] + row * p->n_q, p->n_q);
            }
            if (x->lam && (i == 0 || !held))
                moved_row(lam, x->lam + m.k * p->n_lam,
                          x->lam_b ? x->lam_b + row * p->n_lam : NULL, p->n_lam);
            npy_int32 begin = partials->variable[i], end = partials->variable[i + 1];
            if (held && begin == end)
                continue;
            memset(own, 0, (size_t)size * sizeof *own);
            for (npy_int32 k = begin; k < end; k++)
                move_joint(&m, i, k, IMAGINARY_STEP * I);
            if (!held)
                constraints_complex(p, m.l, x->what, n, c, Z, lam, U, own);
            for (npy_int32 k = begin; k < end; k++) {
                if (held)
                    one_constraint_complex(p, m.l, p->joints + partials->number[k] * JOINT_ITEMS,
                                           x->what, n, c, Z, lam, U, own);
                move_joint(&m, i, k, 0);
            }
            for (npy_intp e = 0; e < size; e++)
                out[e] = cimag(own[e]) / IMAGINARY_STEP;
        }
    }
}

/* How many numbers of work that takes. */
static npy_intp totals_work(const constraint_plan *p, int n)
{
    npy_intp size = p->n_lam > p->n_q ? p->n_lam : p->n_q;
    return p->n_l + (n + 1) * (p->n_c + p->n_q + p->most) + p->n_lam + size;
}
