// The functions of OpenCV that this crate calls, over plain arrays. bridge.rs declares them and is their only caller.
//
// No type and no exception of OpenCV leaves this file; all memory belongs to the caller.
#include <algorithm>
#include <climits>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <exception>
#include <stdexcept>
#include <vector>

#if defined(__unix__) || defined(__APPLE__)
#include <dlfcn.h>
#endif

#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>

namespace {

// As in bridge.rs.
template <typename T> struct Span {
    T *data;
    size_t length;
};
struct Pair {
    double x, y;
};
struct Pose {
    double rotation[3], translation[3];
};
struct Views {
    Span<const size_t> sizes;
    Span<const Pair> object, image;
};
struct Limits {
    int width, height, iterations;
    double change;
};
struct Solved {
    double camera[4], rms;
    Span<double> coefficients, view_rms;
    Span<Pose> poses;
};
enum Status { DONE, NOTHING, EXCEPTION };

// Thrown where a result has not the type or the size that OpenCV's manual names.
struct Unexpected {};

// OpenCV solves its equations with the BLAS of the system. OpenBLAS shares even small ones among threads, which wait
// longer than they compute, and the last bits of the result depend on their number.
void use_one_thread_in_blas() {
#if defined(__unix__) || defined(__APPLE__)
    using Set = void (*)(int);
    if (const auto set = reinterpret_cast<Set>(dlsym(RTLD_DEFAULT, "openblas_set_num_threads"))) set(1);
#endif
}

void use_one_thread() {
    static const bool done = (cv::setNumThreads(1), use_one_thread_in_blas(), true);
    (void)done;
}

Status exception(Span<char> message, const char *what) {
    std::snprintf(message.data, message.length, "%s", what);
    return EXCEPTION;
}

template <typename Work> Status guarded(Span<char> message, Work work) {
    try {
        use_one_thread();
        return work();
    } catch (const Unexpected &) {
        return NOTHING;
    } catch (const std::exception &error) {
        return exception(message, error.what());
    } catch (...) {
        return exception(message, "Unspecified error, neither from OpenCV nor from std");
    }
}

void require(bool condition, const char *what) {
    if (!condition) throw std::length_error(what);
}

// One row of points, those of an object with z = 0.
template <typename Point> cv::Mat row_of(Span<const Pair> from) {
    using T = typename Point::value_type;
    require(from.length <= INT_MAX, "too many points");
    cv::Mat_<Point> row(1, static_cast<int>(from.length));
    std::transform(from.data, from.data + from.length, row.begin(),
                   [](Pair p) { return Point(cv::Point_<T>(static_cast<T>(p.x), static_cast<T>(p.y))); });
    return row;
}

// One row for each view.
std::vector<cv::Mat> by_view(Span<const size_t> sizes, Span<const Pair> points, cv::Mat (*row)(Span<const Pair>)) {
    std::vector<cv::Mat> views;
    for (size_t view = 0; view < sizes.length; view++) {
        const size_t size = sizes.data[view];
        require(size <= points.length, "fewer points than the views have");
        views.push_back(row({points.data, size}));
        points = {points.data + size, points.length - size};
    }
    require(points.length == 0, "more points than the views have");
    return views;
}

void copy(const cv::Mat &from, Span<double> to) {
    const cv::Mat row = from.reshape(1, 1);
    if (row.type() != CV_64F || row.total() != to.length) throw Unexpected();
    std::copy_n(row.ptr<double>(), to.length, to.data);
}

void copy(const std::vector<cv::Mat> &rotations, const std::vector<cv::Mat> &translations, Span<Pose> to) {
    if (rotations.size() != to.length || translations.size() != to.length) throw Unexpected();
    for (size_t i = 0; i < to.length; i++) {
        copy(rotations[i], {to.data[i].rotation, 3});
        copy(translations[i], {to.data[i].translation, 3});
    }
}

void copy(const cv::Mat &camera_matrix, const cv::Mat &coefficients, Solved &to) {
    double m[9];
    copy(camera_matrix, {m, 9});
    const double camera[] = {m[0], m[4], m[2], m[5]};
    std::copy_n(camera, 4, to.camera);
    // calibrateCamera returns coefficients that it has not moved, too.
    copy(coefficients.reshape(1, 1).colRange(0, static_cast<int>(to.coefficients.length)), to.coefficients);
}

cv::TermCriteria criteria(const Limits &limits) {
    return {cv::TermCriteria::COUNT + cv::TermCriteria::EPS, limits.iterations, limits.change};
}

} // namespace

extern "C" {

int evcal_opencv_calibrate_pinhole(const Views &views, const Limits &limits, bool tangential, bool guess,
                                   Solved &solved, Span<char> message) {
    return guarded(message, [&] {
        const auto object = by_view(views.sizes, views.object, row_of<cv::Point3f>);
        const auto image = by_view(views.sizes, views.image, row_of<cv::Point2f>);
        const size_t count = solved.coefficients.length;
        require(count == 4 || count == 5 || count == 8, "4, 5 or 8 coefficients");
        const double(&c)[4] = solved.camera;
        cv::Mat matrix = (cv::Mat_<double>(3, 3) << c[0], 0, c[2], 0, c[1], c[3], 0, 0, 1);
        cv::Mat coefficients = cv::Mat(1, static_cast<int>(count), CV_64F, solved.coefficients.data).clone();
        // LU is much faster than the default SVD, and the refinement that follows needs no more.
        const int flags = cv::CALIB_USE_LU | (guess ? cv::CALIB_USE_INTRINSIC_GUESS : 0) |
                          (tangential ? 0 : cv::CALIB_ZERO_TANGENT_DIST) | (count == 4 ? cv::CALIB_FIX_K3 : 0) |
                          (count == 8 ? cv::CALIB_RATIONAL_MODEL : 0);
        std::vector<cv::Mat> rotations, translations;
        cv::Mat view_rms;
        solved.rms = cv::calibrateCamera(object, image, {limits.width, limits.height}, matrix, coefficients,
                                         rotations, translations, cv::noArray(), cv::noArray(), view_rms, flags,
                                         criteria(limits));
        copy(matrix, coefficients, solved);
        copy(view_rms, solved.view_rms);
        copy(rotations, translations, solved.poses);
        return DONE;
    });
}

int evcal_opencv_calibrate_fisheye(const Views &views, const Limits &limits, Solved &solved, Span<char> message) {
    return guarded(message, [&] {
        const auto object = by_view(views.sizes, views.object, row_of<cv::Point3d>);
        const auto image = by_view(views.sizes, views.image, row_of<cv::Point2d>);
        require(solved.view_rms.length == image.size(), "as many errors as views");
        cv::Mat matrix = cv::Mat::eye(3, 3, CV_64F), coefficients = cv::Mat::zeros(4, 1, CV_64F);
        std::vector<cv::Mat> rotations, translations;
        const int flags = cv::fisheye::CALIB_RECOMPUTE_EXTRINSIC | cv::fisheye::CALIB_FIX_SKEW;
        solved.rms = cv::fisheye::calibrate(object, image, {limits.width, limits.height}, matrix, coefficients,
                                            rotations, translations, flags, criteria(limits));
        copy(matrix, coefficients, solved);
        copy(rotations, translations, solved.poses);
        for (size_t view = 0; view < image.size(); view++) {
            std::vector<cv::Point2d> projected;
            cv::fisheye::projectPoints(object[view], projected, rotations[view], translations[view], matrix,
                                       coefficients);
            if (projected.size() != image[view].total()) throw Unexpected();
            const cv::Point2d *measured = image[view].ptr<cv::Point2d>();
            double sum = 0;
            for (size_t i = 0; i < projected.size(); i++) {
                const cv::Point2d error = projected[i] - measured[i];
                sum += error.x * error.x + error.y * error.y;
            }
            solved.view_rms.data[view] = std::sqrt(sum / static_cast<double>(projected.size()));
        }
        return DONE;
    });
}

int evcal_opencv_find_circles_grid(Span<const Pair> points, int columns, int rows, bool asymmetric, Span<Pair> grid,
                                   Span<char> message) {
    return guarded(message, [&] {
        const int flags = asymmetric ? cv::CALIB_CB_ASYMMETRIC_GRID : cv::CALIB_CB_SYMMETRIC_GRID;
        const cv::Ptr<cv::FeatureDetector> none; // the points are found already
        std::vector<cv::Point2f> circles;
        const bool found = cv::findCirclesGrid(row_of<cv::Point2f>(points), {columns, rows}, circles, flags, none);
        if (!found || circles.size() != grid.length) return NOTHING;
        std::transform(circles.begin(), circles.end(), grid.data, [](cv::Point2f p) { return Pair{p.x, p.y}; });
        return DONE;
    });
}

int evcal_opencv_solve_pnp_ransac(Span<const Pair> object, Span<const Pair> image, int iterations, float threshold,
                                  Span<int> inliers, size_t &found, Span<char> message) {
    return guarded(message, [&] {
        cv::Mat rotation, translation, indices;
        if (!cv::solvePnPRansac(row_of<cv::Point3d>(object), row_of<cv::Point2d>(image), cv::Mat::eye(3, 3, CV_64F),
                                cv::noArray(), rotation, translation, false, iterations, threshold, 0.999, indices,
                                cv::SOLVEPNP_IPPE))
            return NOTHING;
        found = indices.total();
        if (indices.type() != CV_32S || found > inliers.length) throw Unexpected();
        std::copy_n(indices.ptr<int>(), found, inliers.data);
        return DONE;
    });
}

int evcal_opencv_solve_ippe(Span<const Pair> object, Span<const Pair> image, Span<Pose> poses, size_t &found,
                            Span<char> message) {
    return guarded(message, [&] {
        std::vector<cv::Mat> rotations, translations;
        cv::solvePnPGeneric(row_of<cv::Point3d>(object), row_of<cv::Point2d>(image), cv::Mat::eye(3, 3, CV_64F),
                            cv::noArray(), rotations, translations, false, cv::SOLVEPNP_IPPE);
        found = rotations.size();
        if (found > poses.length) throw Unexpected();
        copy(rotations, translations, {poses.data, found});
        return DONE;
    });
}

} // extern "C"
