//! Copies the memory map of the emulated machine to a directory that the linker searches.

use std::path::PathBuf;
use std::{env, fs};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let map = if env::var("CARGO_CFG_TARGET_ARCH")? == "riscv32" { "virt.x" } else { "mps2.x" };
    let out = PathBuf::from(env::var("OUT_DIR")?);
    fs::copy(PathBuf::from("memory").join(map), out.join("memory.x"))?;
    println!("cargo:rerun-if-changed=memory/{map}");
    println!("cargo:rustc-link-search={}", out.display());
    // Set here and not in a configuration file, because the caller's RUSTFLAGS would replace them there.
    for argument in ["-Tmemory.x", "-Tlink.x", "--nmagic"] {
        // link.x of cortex-m-rt includes memory.x itself.
        if map == "virt.x" || argument != "-Tmemory.x" {
            println!("cargo:rustc-link-arg-bins={argument}");
        }
    }
    Ok(())
}
