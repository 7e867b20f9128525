"""Roll and pitch against gravity, from accelerometer, gyro, camera and the climb of the fixes."""
