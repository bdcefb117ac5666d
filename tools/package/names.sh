# Names that the scripts beside share; read with `.` at the top of the workspace.
target=x86_64-unknown-linux-gnu
version=$(sed -n '/^\[workspace.package\]/,/^\[/s/^version = "\(.*\)"/\1/p' Cargo.toml)
target_folder=${CARGO_TARGET_DIR:-target}
packages=$target_folder/packages
name=evcal-$version-$target
archive=$packages/$name.tar.gz
deb=$packages/evcal_${version}_amd64.deb
