//! The default configuration compared with the register traffic of libcaer.

use usb_davis::configuration::Configuration;
use usb_davis::protocol::ImuModel;
use usb_davis::registers::{Clocks, Register, dvs, imu};

fn writes(configuration: &Configuration) -> Vec<(Register, u32)> {
    writes_to(configuration, ImuModel::Mpu9250)
}

fn writes_to(configuration: &Configuration, imu: ImuModel) -> Vec<(Register, u32)> {
    let mut writes = Vec::new();
    configuration.writes(&Clocks::ASSUMED, imu, |register, value| writes.push((register, value)));
    writes
}

#[test]
fn the_default_equals_the_configuration_of_libcaer() {
    let expected: Vec<(Register, u32)> = include_str!("../data/libcaer-default-writes.txt")
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| {
            let (register, value) = line.split_once(' ').expect("register and value");
            let (module, parameter) = register.split_once('.').expect("module.parameter");
            let number = |text: &str| text.parse().expect("a number");
            (Register::new(number(module), number(parameter)), value.parse().expect("a number"))
        })
        .collect();
    assert_eq!(writes(&Configuration::default()), expected);
}

#[test]
fn calibration_differs_in_the_background_activity_filter_only() {
    let default = writes(&Configuration::default());
    let calibration = writes(&Configuration::calibration());
    let different: Vec<_> = default.iter().zip(&calibration).filter(|(one, other)| one != other).collect();
    assert_eq!(different, [(&(dvs::BACKGROUND_ACTIVITY_FILTER, 1), &(dvs::BACKGROUND_ACTIVITY_FILTER, 0))]);
}

#[test]
fn the_gyroscope_filter_is_set_only_if_the_imu_has_one() {
    let mut expected = writes(&Configuration::default());
    expected.retain(|(register, _)| *register != imu::GYROSCOPE_LOW_PASS);
    for imu in [ImuModel::Mpu6050, ImuModel::Absent] {
        assert_eq!(writes_to(&Configuration::default(), imu), expected);
    }
}

#[test]
fn nothing_writes_to_read_only_registers() {
    assert!(writes(&Configuration::default()).iter().all(|(register, _)| !register.is_read_only()));
}
