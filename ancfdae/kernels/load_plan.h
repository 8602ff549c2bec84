/* What a load is: vectors U = L q, and a list of operations that makes forces on them of U and V. */

/* Operations of one or two numbers; `numerics/operations.py` has the same in NumPy. */
enum {
    ADD,
    SUBTRACT,
    MULTIPLY,
    DIVIDE,
    ANGLE,
    POWER,
    NEGATE,
    SQRT,
    EXP,
    LOG,
    SIN,
    COS,
    TAN,
    SINH,
    COSH,
    TANH,
    ARCTAN,
    SQUARE,
    RECIPROCAL,
    POSITIVE, /* x where x > 0, else 0; so is its derivative at 0 */
    STEP,     /* 1 where x > 0, else 0 */
    OPERATIONS
};

/* Numbers are entries of U and V, signals, own numbers of a copy, constants, and results one by one:
 * operation k is op[k] of numbers a[k] and b[k]. Signals are functions of time, given at each time
 * behind the factor. Forces on U are the numbers `output`. Entries of L^T F_U L go to `places` among
 * n_values values: for components i and j, the products of entries in rows i and j of L.
 *
 * A load may have several copies: the same operations on other vectors and own numbers. Copy c has the
 * rows c n_U to (c + 1) n_U - 1 of L. A gate is an operation whose result 0 says that there is no
 * force: the operations behind it are then left out. */
struct LoadTable {
    Size n_q, n_U, n_signals, n_own, n_constants, n_operations, n_numbers, n_values, n_copies, n_gates;
    const int32_t *first, *columns, *op, *a, *b, *output, *places, *gates;
};

/* A list of operations by itself: numbers are inputs, constants and results, as above. It is
 * evaluated at LIST_LANES time points at once.
 *
 * CALL calls the function b[k] of Python; from calls + a[k] on stand its numbers of inputs and
 * outputs, its inputs, and its outputs, -1 for one that is not used. Each output is the number of an
 * operation RESULT behind it, whose a[k] is the number of the call. `called` runs operation k on
 * numbers of one or, where they are complex, two `parts`; `functions` is for its use. */
enum { CALL = OPERATIONS, RESULT, LIST_OPERATIONS };
const Size LIST_LANES = 8;
struct Operations {
    Size n_inputs, n_constants, n_operations, n_outputs, n_numbers;
    const int32_t *op, *a, *b, *outputs, *calls;
    void (*called)(const Operations *p, Size k, Size lanes, int parts, void *numbers);
    void *functions;
};
