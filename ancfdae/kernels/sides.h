/* Whether states keep the sides of sections, tangents and stretches of the first one, as
 * `first_mirrored` of assembly/folds.py asks: by coefficients of Bernstein of the products of r_x,
 * quadratic along an element, and of normals of sections, linear in either slope, or of the chord of
 * a cable. Signs that differ prove nothing. Here for all elements at once; there in words.
 */

#include <initializer_list>

template <int D> struct Vector {
    double x[D];
    static Vector at(const double *from)
    {
        Vector to;
        for (int i = 0; i < D; i++)
            to.x[i] = from[i];
        return to;
    }
    /* a u + b v + c w. */
    static Vector sum(double a, Vector u, double b, Vector v, double c, Vector w)
    {
        Vector to;
        for (int i = 0; i < D; i++)
            to.x[i] = a * u.x[i] + b * v.x[i] + c * w.x[i];
        return to;
    }
};

template <int D> double product(Vector<D> a, Vector<D> b)
{
    double sum = 0;
    for (int i = 0; i < D; i++)
        sum += a.x[i] * b.x[i];
    return sum;
}

/* The normal of a section: r_y turned back by a right angle, or r_y x r_z. */
inline Vector<2> normal_of(Vector<2> y, Vector<2>) { return {{y.x[1], -y.x[0]}}; }
inline Vector<3> normal_of(Vector<3> y, Vector<3> z)
{
    return {{y.x[1] * z.x[2] - y.x[2] * z.x[1], y.x[2] * z.x[0] - y.x[0] * z.x[2],
             y.x[0] * z.x[1] - y.x[1] * z.x[0]}};
}

/* k states of n_q coordinates; vectors of n elements, 2 n_s each with a length and the least |r_x|^2,
 * or of rigid bodies, D + 1 each, without. */
template <int D> struct Sides {
    Size k, n_q, n, each;
    const double *q, *lengths, *least;
    const int64_t *ends;

    /* Whether all products of tangents and normals are positive, up to the sign of the first. */
    static bool positive(int tangents, const Vector<D> *t, int normals, const Vector<D> *n,
                         double *sign)
    {
        if (*sign == 0)
            *sign = product<D>(t[0], n[0]) < 0 ? -1 : 1;
        for (int i = 0; i < tangents; i++)
            for (int j = 0; j < normals; j++)
                if (!(*sign * product<D>(t[i], n[j]) > 0))
                    return false;
        return true;
    }

    bool kept(Size e, const double *state, double *sign) const
    {
        const int64_t *at = ends + e * each;
        auto vector = [&](Size i) { return Vector<D>::at(state + D * at[i]); };
        if (!lengths) {
            Vector<D> along = vector(1), normal = normal_of(vector(2), vector(D));
            return positive(1, &along, 1, &normal, sign);
        }
        Size n_s = each / 2;
        Vector<D> along = vector(1), after = vector(n_s + 1), start = vector(0);
        Vector<D> chord = Vector<D>::sum(1 / lengths[e], vector(n_s), -1 / lengths[e], start, 0, start);
        Vector<D> middle = Vector<D>::sum(1.5, chord, -0.25, along, -0.25, after);
        for (const Vector<D> &r_x : {along, middle, after})
            if (product<D>(r_x, r_x) <= least[e])
                return false;
        Vector<D> t[3] = {along, Vector<D>::sum(3, chord, -1, along, -1, after), after};
        if (n_s == 2 || at[2] == at[0]) {
            double always = 1;
            return positive(3, t, 1, &chord, &always);
        }
        Vector<D> normals[4];
        int count = 0;
        for (Size i = 0; i < 2; i++)
            for (Size j = 0; j < (D == 3 ? 2 : 1); j++)
                normals[count++] = normal_of(vector(2 + i * n_s), vector(D + j * n_s));
        return positive(3, t, count, normals, sign);
    }

    bool kept() const
    {
        for (Size e = 0; e < n; e++) {
            double sign = 0;
            for (Size i = 0; ends[e * each] != ends[e * each + 1] && i < k; i++)
                if (!kept(e, q + i * n_q, &sign))
                    return false;
        }
        return true;
    }
};
