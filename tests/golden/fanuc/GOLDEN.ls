/PROG  GOLDEN
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "machopt";
PROG_SIZE	= 0;
CREATE		= DATE 00-01-01  TIME 00:00:00;
MODIFIED	= DATE 00-01-01  TIME 00:00:00;
FILE_NAME	= ;
VERSION		= 0;
LINE_COUNT	= 63;
MEMORY_SIZE	= 0;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      TASK_PRIORITY	= 50,
      TIME_SLICE	= 0,
      BUSY_LAMP_OFF	= 0,
      ABORT_REQUEST	= 0,
      PAUSE_REQUEST	= 0;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/MN
   1:  !written by machopt from golden ;
   2:  !cell part.apt ;
   3:  !12 moves. First run slowly and ;
   4:  !by hand ;
   5:  !cutting moves run on where that ;
   6:  !passes a point by 0.1 mm at ;
   7:  !most, elsewhere exact stops ;
   8:  !the program changes no tool: ;
   9:  !'LOADTL/12' is a comment in it, ;
  10:  !because the cell has no ;
  11:  !controller.lines.tool ;
  12:  !the program starts no spindle: ;
  13:  !'SPINDL/9000,RPM,CLW' is a ;
  14:  !comment in it, because the cell ;
  15:  !has no ;
  16:  !controller.lines.spindle_on ;
  17:  !the program switches no coolant ;
  18:  !on: 'COOLNT/ON' is a comment in ;
  19:  !it, because the cell has no ;
  20:  !controller.lines.coolant_on ;
  21:  !the program stops no spindle: ;
  22:  !'SPINDL/OFF' is a comment in it, ;
  23:  !because the cell has no ;
  24:  !controller.lines.spindle_off ;
  25:  !UFRAME must be X 1340.378 Y ;
  26:  !-658.397 Z 300.000 W 0.000 P ;
  27:  !0.000 R 6.870 ;
  28:  !UTOOL must be X -20.000 Y ;
  29:  !-180.000 Z 420.000 W 0.000 P ;
  30:  !53.130 R -90.000 ;
  31:  !feeds are rounded to 0.1 mm/sec ;
  32:  !PAYLOAD must be 45.00 kg at X ;
  33:  !0.0 Y -10.0 Z 140.0 ;
  34:  UFRAME_NUM=2 ;
  35:  UTOOL_NUM=3 ;
  36:J P[1] 80% FINE ;
  37:  !operation: Bohren ?6 ;
  38:  !CAM: LOADTL/12 ;
  39:J P[2] 80% FINE ;
  40:  !CAM: SPINDL/9000,RPM,CLW ;
  41:  !move: approach ;
  42:L P[3] 20.0mm/sec FINE ;
  43:  !move: cut ;
  44:L P[4] 2.5mm/sec FINE ;
  45:  !CAM: DELAY/0.5 ;
  46:  WAIT 0.50(sec) ;
  47:  !move: retract ;
  48:L P[5] 20.0mm/sec FINE ;
  49:  !operation: face <1> "fine" ;
  50:J P[6] 80% FINE ;
  51:  !CAM: COOLNT/ON ;
  52:  !move: cut ;
  53:L P[7] 25.0mm/sec CNT100 ;
  54:L P[8] 25.0mm/sec FINE ;
  55:  !CAM: PPRINT/look ;
  56:L P[9] 25.0mm/sec CNT100 ;
  57:L P[10] 12.5mm/sec FINE ;
  58:  !move: retract ;
  59:L P[11] 50.0mm/sec FINE ;
  60:  !CAM: SPINDL/OFF ;
  61:  !CAM: STOP ;
  62:  PAUSE ;
  63:J P[12] 80% FINE ;
/POS
P[1]{
   GP1:
	UF : 2, UT : 3,
	J1= -30.00000 deg,	J2= 0.00000 deg,	J3= 0.00000 deg,
	J4= 0.00000 deg,	J5= 45.00000 deg,	J6= 180.00000 deg
};
P[2]{
   GP1:
	UF : 2, UT : 3,
	J1= -20.00000 deg,	J2= 20.00000 deg,	J3= 30.00000 deg,
	J4= -10.00000 deg,	J5= 40.00000 deg,	J6= 200.00000 deg
};
P[3]{
   GP1:
	UF : 2, UT : 3,		CONFIG : 'F U T, 0, 0, 1',
	X = 252.9064 mm,	Y = -6.2753 mm,	Z = 11.2729 mm,
	W = -178.12658 deg,	P = -31.80124 deg,	R = 138.37954 deg
};
P[4]{
   GP1:
	UF : 2, UT : 3,		CONFIG : 'F U T, 0, 0, 1',
	X = 285.8667 mm,	Y = -22.9752 mm,	Z = -4.4112 mm,
	W = -178.12658 deg,	P = -31.80124 deg,	R = 138.37954 deg
};
P[5]{
   GP1:
	UF : 2, UT : 3,		CONFIG : 'F U T, 0, 0, 1',
	X = 252.9064 mm,	Y = -6.2753 mm,	Z = 11.2729 mm,
	W = -178.12658 deg,	P = -31.80124 deg,	R = 138.37954 deg
};
P[6]{
   GP1:
	UF : 2, UT : 3,
	J1= -30.00000 deg,	J2= 10.00000 deg,	J3= 30.00000 deg,
	J4= 0.00000 deg,	J5= 60.00000 deg,	J6= -10.00000 deg
};
P[7]{
   GP1:
	UF : 2, UT : 3,		CONFIG : 'F U T, 0, 0, 0',
	X = 53.4625 mm,	Y = -50.2601 mm,	Z = 24.2851 mm,
	W = -172.59776 deg,	P = -49.57396 deg,	R = -35.30937 deg
};
P[8]{
   GP1:
	UF : 2, UT : 3,		CONFIG : 'F U T, 0, 0, 0',
	X = 40.9234 mm,	Y = -104.6351 mm,	Z = 7.9109 mm,
	W = -172.64485 deg,	P = -50.71538 deg,	R = -35.42588 deg
};
P[9]{
   GP1:
	UF : 2, UT : 3,		CONFIG : 'F U T, 0, 0, 0',
	X = 25.6622 mm,	Y = -158.8768 mm,	Z = -8.5164 mm,
	W = -172.81378 deg,	P = -51.84903 deg,	R = -35.44298 deg
};
P[10]{
   GP1:
	UF : 2, UT : 3,		CONFIG : 'F U T, 0, 0, 0',
	X = 80.0174 mm,	Y = -190.4723 mm,	Z = 11.6394 mm,
	W = -172.15121 deg,	P = -55.05269 deg,	R = -34.71783 deg
};
P[11]{
   GP1:
	UF : 2, UT : 3,		CONFIG : 'F U T, 0, 0, 0',
	X = 80.9199 mm,	Y = -191.2532 mm,	Z = 104.1872 mm,
	W = -172.98352 deg,	P = -59.02706 deg,	R = -34.01905 deg
};
P[12]{
   GP1:
	UF : 2, UT : 3,
	J1= -30.00000 deg,	J2= 0.00000 deg,	J3= 0.00000 deg,
	J4= 0.00000 deg,	J5= 45.00000 deg,	J6= 180.00000 deg
};
/END
