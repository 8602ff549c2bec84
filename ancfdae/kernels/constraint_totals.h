/* Total design derivatives of constraints, by complex steps of all that they are made of. */

const double IMAGINARY_STEP = 0x1p-133;

/* What design variables change: variable i reaches the joints number[variable[i]] to
 * number[variable[i + 1] - 1]; the entries of the k-th of these are first[k] to first[k + 1] - 1:
 * one below n_l is of L, the others are of coefficients in a part. `factors_b` are partials of the
 * factors, (n_b, orders, instants, n_parts), or nullptr. */
struct ConstraintPartials {
    Size n_b, orders;
    const int32_t *variable, *number, *first, *part, *entry;
    const double *value, *factors_b;
};

/* Everything at one instant, to be moved: rows c of coefficients, l and states. */
struct MovedConstraints {
    const ConstraintTable *p;
    const ConstraintPartials *of;
    int n;
    Size k, instants;
    const double *factors, *moving;
    Complex *l, *c;
};

const double *factors_at(const MovedConstraints *m, int order)
{
    return m->factors + (order * m->instants + m->k) * m->p->n_parts;
}

/* Add s times the partials in variable i to what joint `number` has, whose entries are those of k;
 * s = 0 takes them out. */
void move_joint(const MovedConstraints *m, Size i, Size k, Complex s)
{
    const ConstraintTable *p = m->p;
    const int32_t *joint = p->joints + m->of->number[k] * JOINT_ITEMS;
    for (int32_t at = m->of->first[k]; at < m->of->first[k + 1]; at++) {
        Size e = m->of->entry[at];
        if (e < p->n_l) {
            m->l[e] = real_part(m->l[e]) + s * m->of->value[at];
            continue;
        }
        for (int order = 0; order <= m->n; order++) {
            Complex *c = m->c + order * p->n_c + e - p->n_l;
            double factor = factors_at(m, order)[m->of->part[at]];
            *c = s == 0 ? real_part(*c) : *c + s * factor * m->of->value[at];
        }
    }
    if (!m->of->factors_b)
        return;
    for (int order = 0; order <= m->n; order++) {
        const double *own =
            m->of->factors_b + ((i * m->of->orders + order) * m->instants + m->k) * p->n_parts;
        for (int32_t e = joint[MOVING]; e < joint[JOINT_ITEMS + MOVING]; e++) {
            Complex *c = m->c + order * p->n_c + p->moving_at[e];
            *c = s == 0 ? real_part(*c) : *c + s * own[p->moving_part[e]] * m->moving[e];
        }
    }
}

/* Coefficients at one instant, not moved; c[order] is nullptr where it vanishes, whatever moves. */
void still_coefficients(const MovedConstraints *m, const ConstraintNumbers<double> *of,
                        const Complex **c)
{
    const ConstraintTable *p = m->p;
    for (int order = 0; order <= m->n; order++) {
        Complex *own = m->c + order * p->n_c;
        const double *factor = factors_at(m, order);
        c[order] = p->n_parts > 1 || factor[0] != 0 ? own : nullptr;
        for (Size e = 0; e < p->n_c; e++)
            own[e] = factor[0] * of->part_0[e];
        for (Size e = 0; e < p->n_moving; e++)
            own[p->moving_at[e]] += factor[p->moving_part[e]] * of->moving[e];
    }
}

/* The states of a total derivative: the coordinates X[k], (instants, n_q), and lam, and with X_b
 * their derivatives, (instants, n_b, ...), nullptr of those that are held. */
struct TotalStates {
    int what, n;
    Size instants;
    const double *factors, *X[ORDERS], *X_b[ORDERS], *lam, *lam_b;
};

void moved_row(Complex *out, const double *x, const double *x_b, Size size)
{
    for (Size i = 0; i < size; i++)
        out[i] = Complex(x[i], x_b ? IMAGINARY_STEP * x_b[i] : 0);
}

/* Rows of out, (instants, n_b, size): the total derivatives of Phi or Phi_q^T lam of order n. A
 * joint that a variable does not reach has none where the states are held. */
void constraint_totals(const ConstraintTable *p, const ConstraintNumbers<double> *of,
                       const ConstraintPartials *partials, const TotalStates *x, Complex *work,
                       double *out)
{
    const Complex *c[ORDERS], *Z[ORDERS];
    int n = x->n, held = !x->X_b[0];
    Size size = x->what == RATE ? p->n_lam : p->n_q;
    MovedConstraints m = {p, partials, n, 0, x->instants, x->factors, of->moving, work, nullptr};
    m.c = m.l + p->n_l;
    Complex *z = m.c + (n + 1) * p->n_c, *lam = z + (n + 1) * p->n_q, *U = lam + p->n_lam;
    Complex *own = U + vectors_room(p, n);
    moved_row(m.l, of->l, nullptr, p->n_l);
    for (; m.k < x->instants; m.k++) {
        still_coefficients(&m, of, c);
        for (Size i = 0; i < partials->n_b; i++, out += size) {
            Size row = m.k * partials->n_b + i;
            for (int k = 0; k <= n && (i == 0 || !held); k++) {
                Z[k] = z + k * p->n_q;
                moved_row(z + k * p->n_q, x->X[k] + m.k * p->n_q,
                          x->X_b[k] ? x->X_b[k] + row * p->n_q : nullptr, p->n_q);
            }
            if (x->lam && (i == 0 || !held))
                moved_row(lam, x->lam + m.k * p->n_lam,
                          x->lam_b ? x->lam_b + row * p->n_lam : nullptr, p->n_lam);
            int32_t begin = partials->variable[i], end = partials->variable[i + 1];
            if (held && begin == end)
                continue;
            memset(own, 0, (size_t)size * sizeof *own);
            for (int32_t k = begin; k < end; k++)
                move_joint(&m, i, k, Complex(0, IMAGINARY_STEP));
            if (!held)
                constraints<Complex>(p, m.l, x->what, n, c, Z, lam, U, own);
            for (int32_t k = begin; k < end; k++) {
                if (held)
                    one_constraint<Complex>(p, m.l, p->joints + partials->number[k] * JOINT_ITEMS,
                                            x->what, n, c, Z, lam, U, own);
                move_joint(&m, i, k, 0);
            }
            for (Size e = 0; e < size; e++)
                out[e] = imaginary_part(own[e]) / IMAGINARY_STEP;
        }
    }
}

/* How many numbers of work that takes. */
Size totals_work(const ConstraintTable *p, int n)
{
    Size size = p->n_lam > p->n_q ? p->n_lam : p->n_q;
    return p->n_l + (n + 1) * (p->n_c + p->n_q) + vectors_room(p, n) + p->n_lam + size;
}
