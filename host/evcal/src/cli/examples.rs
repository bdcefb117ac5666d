//! The examples below the help of each subcommand.

pub const EVCAL: &str = "\
From a printed board to a calibrated camera:
  evcal board --pdf board.pdf
  evcal record recording.dvraw
  evcal calibrate recording.dvraw --board acircles:9x4:23mm:r7.3mm -o calibration
  evcal export calibration --format ros -o camera_info.yaml

Each subcommand has examples: evcal calibrate --help";

pub const CALIBRATE: &str = "\
Examples:
  A recording and its board (spacing, which is half the distance of neighbours in a row, and radius):
    evcal calibrate recording.aedat4 --board acircles:9x4:55mm:r17.5mm -o calibration
  Only the spacing and radius of the board are known:
    evcal calibrate recording.aedat4 --board auto:55mm:r17.5mm -o calibration
  Text with other columns, times in milliseconds:
    evcal calibrate events.txt --columns x,y,p,t --time-unit ms --board circles:6x3:40mm:r9mm -o out
  A fisheye lens, or the best model:
    evcal calibrate recording.dvraw --board acircles:9x4:55mm:r17.5mm --model kannala-brandt -o out
    evcal calibrate recording.dvraw --board acircles:9x4:55mm:r17.5mm --model auto -o out

The exit code is 3 if a verdict is \"not good enough\", unless --accept-any is given.";

pub const DETECT: &str = "\
Examples:
  evcal detect recording.dvraw --board acircles:9x4:55mm:r17.5mm -o circles.csv
  A board with unknown rows and columns:
    evcal detect recording.dvraw --board auto -o circles.csv
  All circles, and a picture of the window with most circles:
    evcal detect recording.dvraw --picture circles.png
  Circles from a detector on a serial port:
    evcal detect serial:/dev/ttyACM0?seconds=30 --board acircles:9x4:55mm:r17.5mm -o circles.csv";

pub const DEVICES: &str = "\
Examples:
  evcal devices
  evcal devices --json";

pub const RECORD: &str = "\
Examples:
  Until Ctrl-C:
    evcal record recording.dvraw
  Half a minute, with frames:
    evcal record recording.dvraw --frames --duration 30s";

pub const LIVE: &str = "\
Examples:
  With a camera; open the printed address in a browser:
    evcal live --board acircles:9x4:55mm:r17.5mm -o calibration
  Without a camera:
    evcal live --replay recording.dvraw --board acircles:9x4:55mm:r17.5mm -o calibration
  From any other camera, by its own program:
    CAMERA_PROGRAM | evcal live - --board acircles:9x4:55mm:r17.5mm -o calibration
    evcal live recording.aedat4 --follow --board acircles:9x4:55mm:r17.5mm -o calibration
  Hints on the terminal once per second, as JSON; the last object is the calibration:
    evcal live --board acircles:9x4:55mm:r17.5mm -o calibration --no-page --json";

pub const INFO: &str = "\
Examples:
  evcal info recording.aedat4
  evcal info events.txt --columns t,x,y,p --time-unit ms --sensor 346x260";

pub const CHECK: &str = "\
Examples:
  evcal check recording.aedat4 --board acircles:9x4:55mm:r17.5mm
  Recognise the board:
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
  The camera's frames as pictures, with the whole field of view:
    evcal undistort recording.dvraw -c calibration --frames pictures --alpha 1";

pub const BOARD: &str = "\
Examples:
  The largest board that fits on A4:
    evcal board --pdf board.pdf
  A given board, on another paper:
    evcal board --board acircles:9x4:55mm:r17.5mm --paper 600x460mm --pdf board.pdf";

pub const SIMULATE: &str = "\
Examples:
  evcal simulate -o simulation
  evcal calibrate simulation/events.aedat4 --board acircles:9x4:55mm:r17.5mm -o calibration
  evcal evaluate calibration --truth simulation
  Your camera in dim light, with frames:
    evcal simulate --camera calibration --light low --frames -o simulation";

pub const COMPLETIONS: &str = "\
Examples:
  evcal completions bash > ~/.local/share/bash-completion/completions/evcal
  evcal completions zsh > ~/.zfunc/_evcal
  evcal completions fish > ~/.config/fish/completions/evcal.fish";

pub const MAN: &str = "\
Examples:
  evcal man ~/.local/share/man/man1";
