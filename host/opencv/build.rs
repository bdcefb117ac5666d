//! Compiles `src/bridge.cpp` against the OpenCV of the system.

fn main() {
    println!("cargo::rerun-if-changed=src/bridge.cpp");
    // The package lists all libraries of OpenCV, but the bridge needs only two.
    let Ok(opencv) = pkg_config::Config::new().atleast_version("4").cargo_metadata(false).probe("opencv4") else {
        println!(
            "cargo::error=pkg-config finds no opencv4: OpenCV 4 and its headers are needed (Debian: libopencv-dev)"
        );
        return;
    };
    cc::Build::new()
        .cpp(true)
        .std("c++11")
        // The same sums on every processor.
        .flag_if_supported("-ffp-contract=off")
        .includes(opencv.include_paths)
        .file("src/bridge.cpp")
        .compile("evcal_opencv_bridge");
    for path in opencv.link_paths {
        println!("cargo::rustc-link-search=native={}", path.display());
    }
    println!("cargo::rustc-link-lib=opencv_calib3d");
    println!("cargo::rustc-link-lib=opencv_core");
}
