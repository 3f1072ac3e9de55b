MODULE mo_golden
  ! written by machopt from golden cell; part.apt
  ! 12 moves. First run slowly and by hand
  ! cutting moves run on where that passes a point by 0.1 mm at most, elsewhere exact stops
  ! the program changes no tool: 'LOADTL/12' is a comment in it, because the cell has no controller.lines.tool
  ! the program starts no spindle: 'SPINDL/9000,RPM,CLW' is a comment in it, because the cell has no
  ! controller.lines.spindle_on
  ! the program switches no coolant on: 'COOLNT/ON' is a comment in it, because the cell has no controller.lines.coolant_on
  ! the program stops no spindle: 'SPINDL/OFF' is a comment in it, because the cell has no controller.lines.spindle_off
  ! rapid moves run at a TCP speed of 1000 mm/s, not at a share of the axis limits
  ! workpiece (frame of the CAM coordinates) and tool of the cell
  PERS tooldata t_golden:=[TRUE,[[-20.0000,-180.0000,420.0000],[0.63245553,0.31622777,0.31622777,-0.63245553]],[45.000,[0.00,-10.00,140.00],[1,0,0,0],0,0,0]];
  PERS wobjdata w_golden:=[FALSE,TRUE,"",[[1340.3779,-658.3975,300.0000],[0.99820347,0.00000000,0.00000000,0.05991526]],[[0,0,0],[1,0,0,0]]];
  CONST speeddata r_golden:=[1000,500,5000,1000];
  CONST zonedata z1_golden:=[FALSE,0.160,0.160,0.160,0.1,0.160,0.1];
  CONST zonedata z2_golden:=[FALSE,0.250,0.250,0.250,0.1,0.250,0.1];
  CONST speeddata v1_golden:=[20.0000,500,5000,1000];
  CONST speeddata v2_golden:=[2.5000,500,5000,1000];
  CONST speeddata v3_golden:=[25.0000,500,5000,1000];
  CONST speeddata v4_golden:=[12.5000,500,5000,1000];
  CONST speeddata v5_golden:=[50.0000,500,5000,1000];

  PROC golden()
    ConfJ\On;
    ConfL\On;
    MoveAbsJ [[-30.00000,0.00000,0.00000,0.00000,45.00000,180.00000],[9E9,9E9,9E9,9E9,9E9,9E9]],r_golden,fine,t_golden\WObj:=w_golden;
    ! operation: Bohren ?6
    ! CAM: LOADTL/12
    MoveAbsJ [[-20.00000,20.00000,30.00000,-10.00000,40.00000,200.00000],[9E9,9E9,9E9,9E9,9E9,9E9]],r_golden,fine,t_golden\WObj:=w_golden;
    ! CAM: SPINDL/9000,RPM,CLW
    ! move: approach
    MoveL [[252.9064,-6.2753,11.2729],[0.26164798,-0.33744824,-0.90046777,-0.08262453],[-1,-1,2,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v1_golden,fine,t_golden\WObj:=w_golden;
    ! move: cut
    MoveL [[285.8667,-22.9752,-4.4112],[0.26164798,-0.33744824,-0.90046777,-0.08262453],[-1,-1,2,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v2_golden,fine,t_golden\WObj:=w_golden;
    WaitTime 0.500; ! CAM: DELAY/0.5
    ! move: retract
    MoveL [[252.9064,-6.2753,11.2729],[0.26164798,-0.33744824,-0.90046777,-0.08262453],[-1,-1,2,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v1_golden,fine,t_golden\WObj:=w_golden;
    ! operation: face <1>; "fine"
    MoveAbsJ [[-30.00000,10.00000,30.00000,0.00000,60.00000,-10.00000],[9E9,9E9,9E9,9E9,9E9,9E9]],r_golden,fine,t_golden\WObj:=w_golden;
    ! CAM: COOLNT/ON
    ! move: cut
    MoveL [[53.4625,-50.2601,24.2851],[0.07103886,0.87151680,-0.24897650,0.41644045],[-1,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v3_golden,z1_golden,t_golden\WObj:=w_golden;
    MoveL [[40.9234,-104.6351,7.9109],[0.07481747,0.86739725,-0.24820073,0.42475965],[-1,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v3_golden,fine,t_golden\WObj:=w_golden;
    ! CAM: PPRINT/look
    MoveL [[25.6622,-158.8768,-8.5164],[0.07912439,0.86334919,-0.24712310,0.43277902],[-1,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v3_golden,z2_golden,t_golden\WObj:=w_golden;
    MoveL [[80.0174,-190.4723,11.6394],[0.07963576,0.85386114,-0.23377223,0.45818102],[-1,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v4_golden,fine,t_golden\WObj:=w_golden;
    ! move: retract
    MoveL [[80.9199,-191.2532,104.1872],[0.09291678,0.83943059,-0.22526834,0.48577457],[-1,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v5_golden,fine,t_golden\WObj:=w_golden;
    ! CAM: SPINDL/OFF
    Stop; ! CAM: STOP
    MoveAbsJ [[-30.00000,0.00000,0.00000,0.00000,45.00000,180.00000],[9E9,9E9,9E9,9E9,9E9,9E9]],r_golden,fine,t_golden\WObj:=w_golden;
  ENDPROC
ENDMODULE
