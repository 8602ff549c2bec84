/* Scalars that formulas are computed in: double, and complex numbers of this file.
 *
 * A complex number has the layout of NumPy's and LAPACK's. Its products follow the textbook without
 * tests for infinities; a product with a real number takes two multiplications.
 */

struct Complex {
    double re, im;
    Complex() = default;
    constexpr Complex(double real, double imaginary = 0) : re(real), im(imaginary) {}
};

INLINE Complex operator-(Complex a) { return {-a.re, -a.im}; }
INLINE Complex operator+(Complex a, Complex b) { return {a.re + b.re, a.im + b.im}; }
INLINE Complex operator+(Complex a, double b) { return {a.re + b, a.im}; }
INLINE Complex operator+(double a, Complex b) { return {a + b.re, b.im}; }
INLINE Complex operator-(Complex a, Complex b) { return {a.re - b.re, a.im - b.im}; }
INLINE Complex operator-(Complex a, double b) { return {a.re - b, a.im}; }
INLINE Complex operator-(double a, Complex b) { return {a - b.re, -b.im}; }
INLINE Complex operator*(Complex a, double b) { return {a.re * b, a.im * b}; }
INLINE Complex operator*(double a, Complex b) { return {a * b.re, a * b.im}; }
INLINE Complex operator*(Complex a, Complex b)
{
    return {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
}
INLINE Complex operator/(Complex a, double b) { return {a.re / b, a.im / b}; }
INLINE Complex operator/(Complex a, Complex b)
{
    double size = b.re * b.re + b.im * b.im;
    return {(a.re * b.re + a.im * b.im) / size, (a.im * b.re - a.re * b.im) / size};
}
template <class S> INLINE Complex &operator+=(Complex &a, S b) { return a = a + b; }
template <class S> INLINE Complex &operator-=(Complex &a, S b) { return a = a - b; }
template <class S> INLINE Complex &operator*=(Complex &a, S b) { return a = a * b; }
template <class S> INLINE Complex &operator/=(Complex &a, S b) { return a = a / b; }
INLINE bool operator==(Complex a, Complex b) { return a.re == b.re && a.im == b.im; }
INLINE bool operator!=(Complex a, Complex b) { return !(a == b); }

INLINE double real_part(double x) { return x; }
INLINE double real_part(Complex x) { return x.re; }
INLINE double imaginary_part(double) { return 0; }
INLINE double imaginary_part(Complex x) { return x.im; }

/* Complex numbers go to the functions of the library. */
INLINE std::complex<double> of_library(Complex x) { return {x.re, x.im}; }
INLINE Complex of_library(std::complex<double> x) { return {x.real(), x.imag()}; }
using std::atan;
using std::cos;
using std::cosh;
using std::exp;
using std::log;
using std::pow;
using std::sin;
using std::sinh;
using std::sqrt;
using std::tan;
using std::tanh;
#define OF_COMPLEX(f)                                                                              \
    inline Complex f(Complex x) { return of_library(std::f(of_library(x))); }
OF_COMPLEX(atan)
OF_COMPLEX(cos)
OF_COMPLEX(cosh)
OF_COMPLEX(exp)
OF_COMPLEX(log)
OF_COMPLEX(sin)
OF_COMPLEX(sinh)
OF_COMPLEX(sqrt)
OF_COMPLEX(tan)
OF_COMPLEX(tanh)
#undef OF_COMPLEX
/* Whole exponents are products: the logarithm of a negative number would lose the imaginary part of a
 * complex step, which is far below round-off. */
inline Complex pow(Complex x, Complex y)
{
    if (y.im == 0 && y.re == std::floor(y.re) && std::fabs(y.re) <= 1e9) {
        Complex power = 1.0, factor = y.re < 0 ? 1.0 / x : x;
        for (int n = (int)std::fabs(y.re); n > 0; n /= 2, factor = factor * factor)
            if (n % 2)
                power = power * factor;
        return power;
    }
    return of_library(std::pow(of_library(x), of_library(y)));
}

/* The angle of (x, y), rad; complex numbers must be real except for a tiny imaginary step. */
inline double angle_of(double y, double x) { return atan2(y, x); }
inline Complex angle_of(Complex y, Complex x)
{
    double size = x.re * x.re + y.re * y.re;
    return {atan2(y.re, x.re), (x.re * y.im - y.re * x.im) / size};
}

/* Run f, of which there is a second copy for processors with wide vectors: chosen when the module is
 * loaded, by glibc, and GCC knows that name of a processor here from version 12 on. */
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__gnu_linux__) &&   \
    __GNUC__ >= 12
#define WITH_WIDE_VECTORS __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define WITH_WIDE_VECTORS
#endif

template <class F> WITH_WIDE_VECTORS auto in_two_copies(const F f) -> decltype(f()) { return f(); }

/* The same for real numbers only. */
template <class T, class F> INLINE auto widely(const F f) -> decltype(f())
{
    if constexpr (std::is_same<T, double>::value)
        return in_two_copies(f);
    else
        return f();
}

/* Run f(n_y, d) for elements of a size. For real numbers there is one copy for each size that
 * elements have, so that its loops have constant bounds. Complex numbers, whose products cost more
 * than loops, do with one of any size, in a third of the compiler's time. */
template <class T, class F> INLINE void each_size(int n_y, int d, const F f)
{
    widely<T>([=]() ALWAYS {
        if constexpr (std::is_same<T, double>::value)
            switch (n_y * 10 + d) {
            case 73: return f(7, 3);
            case 52: return f(5, 2);
            case 33: return f(3, 3);
            case 32: return f(3, 2);
            }
        f(n_y, d);
    });
}
