//! What stands below the help of each subcommand: commands to begin with.

pub const EVCAL: &str = "\
From a printed board to a calibrated camera:
  evcal board --pdf board.pdf
  evcal record recording.dvraw
  evcal calibrate recording.dvraw --board acircles:9x4:23mm:r7.3mm -o calibration
  evcal export calibration --format ros -o camera_info.yaml

Each subcommand has examples of its own: evcal calibrate --help";

pub const CALIBRATE: &str = "\
Examples:
  A recording and the board in it (half the distance in a row, and the radius):
    evcal calibrate recording.aedat4 --board acircles:9x4:55mm:r17.5mm -o calibration
  A board of which only the size is known, half the distance in a row and the radius:
    evcal calibrate recording.aedat4 --board auto:55mm:r17.5mm -o calibration
  Text in columns of its own, times in milliseconds:
    evcal calibrate events.txt --columns x,y,p,t --time-unit ms --board circles:6x3:40mm:r9mm -o out
  A fisheye, or whichever model fits best:
    evcal calibrate recording.dvraw --board acircles:9x4:55mm:r17.5mm --model kannala-brandt -o out
    evcal calibrate recording.dvraw --board acircles:9x4:55mm:r17.5mm --model auto -o out

The exit code is 3 where a verdict is \"not good enough\", unless --accept-any is given.";

pub const DETECT: &str = "\
Examples:
  evcal detect recording.dvraw --board acircles:9x4:55mm:r17.5mm -o circles.csv
  A board of which rows and columns are not known:
    evcal detect recording.dvraw --board auto -o circles.csv
  Any circles, and a picture of the window with most of them:
    evcal detect recording.dvraw --picture circles.png
  What a detector sends over a serial port:
    evcal detect serial:/dev/ttyACM0?seconds=30 --board acircles:9x4:55mm:r17.5mm -o circles.csv";

pub const DEVICES: &str = "\
Examples:
  evcal devices
  evcal devices --json";

pub const RECORD: &str = "\
Examples:
  Until Ctrl-C:
    evcal record recording.dvraw
  With frames, half a minute:
    evcal record recording.dvraw --frames --duration 30s";

pub const LIVE: &str = "\
Examples:
  With a camera; open the address that is printed in a browser:
    evcal live --board acircles:9x4:55mm:r17.5mm -o calibration
  Without a camera:
    evcal live --replay recording.dvraw --board acircles:9x4:55mm:r17.5mm -o calibration
  On a terminal alone, the same hints once a second; as JSON, the calibration is the last object:
    evcal live --board acircles:9x4:55mm:r17.5mm -o calibration --no-page --json";

pub const INFO: &str = "\
Examples:
  evcal info recording.aedat4
  evcal info events.txt --columns t,x,y,p --time-unit ms --sensor 346x260";

pub const CHECK: &str = "\
Examples:
  evcal check recording.aedat4 --board acircles:9x4:55mm:r17.5mm
  Which board is it?
    evcal check recording.aedat4
  evcal check events.txt --time-unit ms --sensor 346x260";

pub const COMPARE: &str = "\
Examples:
  evcal compare monday tuesday
  evcal compare monday/calibration.json tuesday/calibration.json --json";

pub const CONVERT: &str = "\
Examples:
  evcal convert recording.dvraw recording.aedat4
  evcal convert events.txt events.bin --columns x,y,p,t --time-unit us --sensor 346x260";

pub const EVALUATE: &str = "\
Examples:
  evcal evaluate calibration --truth simulation
  evcal evaluate monday/calibration.json --truth tuesday/calibration.json --json";

pub const REPEAT: &str = "\
Examples:
  evcal repeat recording.dvraw --board acircles:9x4:55mm:r17.5mm
  Twenty parts of two seconds:
    evcal repeat recording.dvraw --board acircles:9x4:55mm:r17.5mm --runs 20 --seconds 2s";

pub const EXPORT: &str = "\
Examples:
  evcal export calibration --format ros -o camera_info.yaml
  evcal export calibration --format all -o exports
  A table for a microcontroller:
    evcal export calibration --c-header undistort.h --max-error 0.05";

pub const UNDISTORT: &str = "\
Examples:
  evcal undistort recording.dvraw -c calibration -o undistorted.aedat4
  evcal undistort picture.png -c calibration -o undistorted.png
  The camera's frames as pictures, all that the lens sees in them:
    evcal undistort recording.dvraw -c calibration --frames pictures --alpha 1";

pub const BOARD: &str = "\
Examples:
  The largest board that fits on A4:
    evcal board --pdf board.pdf
  A given one, on a paper of its own:
    evcal board --board acircles:9x4:55mm:r17.5mm --paper 600x460mm --pdf board.pdf";

pub const SIMULATE: &str = "\
Examples:
  evcal simulate -o simulation
  evcal calibrate simulation/events.aedat4 --board acircles:9x4:55mm:r17.5mm -o calibration
  evcal evaluate calibration --truth simulation
  Your own camera, in dim light, with frames:
    evcal simulate --camera calibration --light low --frames -o simulation";

pub const COMPLETIONS: &str = "\
Examples:
  evcal completions bash > ~/.local/share/bash-completion/completions/evcal
  evcal completions zsh > ~/.zfunc/_evcal
  evcal completions fish > ~/.config/fish/completions/evcal.fish";

pub const MAN: &str = "\
Examples:
  evcal man ~/.local/share/man/man1";
