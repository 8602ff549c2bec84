/* Where the numbers of constraints stand; `constraints.h` says what they are. */

/* Orders of time derivatives, and what counts to the begin of a joint: its vectors, linear entries,
 * products, rows, parts, entries that move and inputs of formulas, and places of entries. */
enum { ORDERS = 4 };
/* What is asked of constraints: Phi, values of Phi_q, or Phi_q^T lam. */
enum { RATE, VALUES, FORCE };
enum {
    VECTOR,
    LINEAR,
    PRODUCT,
    ROW,
    PART,
    MOVING,
    INPUT,
    PLACE_LINEAR,
    PLACE_PRODUCT,
    PLACE_FORMULA,
    JOINT_ITEMS
};

const double BINOMIAL[ORDERS][ORDERS] = {{1}, {1, 1}, {1, 2, 1}, {1, 3, 3, 1}};

/* Lists of a joint's formula Phi(U, z) and what they return: Phi, Phi_U and Phi_z, row by row, and
 * (Phi_U^T lam)_U; and their time derivatives of an order. They take U and z of all orders up to
 * their own, order by order, and the last ones lam. */
enum { OF_PHI, OF_VECTORS = ORDERS, OF_INPUTS = 2 * ORDERS, OF_CURVATURE = OF_INPUTS + 2 };
enum { FORMULA_LISTS = OF_CURVATURE + 2, FORMULA_ORDERS = 2 };
struct Formula {
    const Operations *lists[FORMULA_LISTS];
    const double *in_real[FORMULA_LISTS];
    const Complex *in_complex[FORMULA_LISTS];
};

/* `joints` has a row for the begin of every joint and one for the end. Row r of L has the entries
 * first[r] to first[r + 1] - 1. Linear entry e picks component linear_at[e] of U; the vectors of
 * product e begin at components i[e] and j[e]. Products of raw entries of Phi_U with entries of L
 * go to places among n_values values of Phi_q, pairs of entries of L to two places each among
 * n_curved of (Phi_q^T lam)_q. A joint has at most `most` components of vectors.
 *
 * Joint k has the formula formula[k] of `formulas`, -1 without one. Entries of Phi_U times entries
 * of L go to place_formula, row by row; curved has the places of pairs of entries of L behind the
 * places of products. `room` numbers are written to when lists are evaluated. */
struct ConstraintTable {
    Size n_joints, n_q, n_lam, n_parts, n_a, n_s, n_z, n_c, n_l, n_moving, n_values, n_curved;
    Size most, n_formulas, room;
    int d;
    const int32_t *joints, *first, *columns, *linear_row, *linear_at, *row, *i, *j;
    const int32_t *place_linear, *place_product, *place_formula, *curved, *curved_formula,
        *moving_at, *moving_part;
    const int32_t *formula;
    const Formula *formulas;
};
