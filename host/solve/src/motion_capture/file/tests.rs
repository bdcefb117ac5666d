use super::*;

const MOTIVE: &str = "Format Version,1.23,Take Name,one,Capture Frame Rate,120.000000,Rotation Type,Quaternion,Length Units,Millimeters,Coordinate Space,Global\n\
\n\
,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body Marker,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body\n\
,Name,camera,camera,camera,camera,camera,camera,camera,camera,camera:Marker1,board,board,board,board,board,board,board\n\
,ID,A,A,A,A,A,A,A,A,B,C,C,C,C,C,C,C\n\
,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error,Position,Rotation,Rotation,Rotation,Rotation,Position,Position,Position\n\
Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,X,Y,Z,W,X,Y,Z\n\
0,0.000000,0,0,0.707107,0.707107,1000,2000,3000,0.1,5,0,0,0,1,7,8,9\n\
1,0.008333,,,,,,,,,,0,0,0,1,7,8,9\n\
2,0.016667,0,0,0.707107,0.707107,1001,2000,3000,0.1,5,0,0,0,1,7,8,9\n";

fn message(text: &str, body: Option<&str>) -> String {
    parse(text, body).unwrap_err().to_string()
}

#[test]
fn motive_is_read_by_the_names_of_its_columns() {
    let poses = parse(MOTIVE, Some("camera")).unwrap();
    assert_eq!(poses.iter().map(|pose| pose.t).collect::<Vec<_>>(), [0.0, 0.016667]);
    assert!((poses[1].pose.translation.vector - Vector3::new(1.001, 2.0, 3.0)).norm() < 1e-12);
    assert!((poses[0].pose.rotation * Vector3::x() - Vector3::y()).norm() < 1e-6);
    assert_eq!(parse(MOTIVE, Some("board")).unwrap().len(), 3);
    let marked = format!("\u{feff}{}", MOTIVE.replace('\n', "\r\n"));
    assert_eq!(parse(&marked, Some("camera")).unwrap(), poses);
}

#[test]
fn errors_in_motive_files_name_what_to_export() {
    assert!(message(MOTIVE, None).contains("several rigid bodies, \"camera\", \"board\""));
    assert!(message(MOTIVE, Some("hat")).contains("no rigid body \"hat\""));
    assert!(message(&MOTIVE.replace("Quaternion", "XYZ"), None).contains("Rotation Type Quaternion"));
    assert!(message(&MOTIVE.replace("Millimeters", "Furlongs"), None).contains("Furlongs"));
    assert!(message(&MOTIVE.replace("Global", "Local"), None).contains("Coordinate Space Global"));
    assert!(message(&MOTIVE.replace("Rigid Body", "Marker"), None).contains("no rigid body in the file"));
    assert!(message(&MOTIVE.replace(",1001,", ",1oo1,"), Some("camera")).contains("line 10: \"1oo1\""));
    assert!(message(&MOTIVE.replace("2,0.016667", "2,0.0"), Some("camera")).contains("line 10: its time"));
}

#[test]
fn euroc_has_nanoseconds_and_w_first() {
    let text = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v_RS_R_x [m s^-1]\n\
                1403636580838555648,4.688,-1.786,0.783,0.707107,0,0,0.707107,-0.02\n\
                1403636580843555648,4.689,-1.787,0.784,0.707107,0,0,0.707107,-0.02\n";
    let poses = parse(text, None).unwrap();
    assert!((poses[1].t - poses[0].t - 0.005).abs() < 1e-6);
    assert!((poses[0].pose.rotation * Vector3::x() - Vector3::y()).norm() < 1e-6);
    assert_eq!(poses[1].pose.translation.vector, Vector3::new(4.689, -1.787, 0.784));
    assert!(message(&text.replace("4.689", ""), None).contains("line 3: \"\" is not a number"));
    assert!(message(&text.replace(",0.707107,0,0,", ",0.9,0,0,"), None).contains("line 2: the quaternion"));
    assert!(message(text, Some("body")).contains("do not name one"));
}

#[test]
fn anything_else_is_tum() {
    assert_eq!(parse("0 1 2 3 0 0 0 1\n0.1 1 2 3 0 0 0 1\n", None).unwrap().len(), 2);
    assert!(message("a,b\n", None).contains("OptiTrack Motive"));
    assert!(message("", None).contains("no pose"));
}
