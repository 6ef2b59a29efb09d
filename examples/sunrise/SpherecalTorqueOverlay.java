package application;

import static com.kuka.roboticsAPI.motionModel.BasicMotions.positionHold;

import java.util.concurrent.TimeUnit;
import java.util.concurrent.TimeoutException;

import com.kuka.connectivity.fastRobotInterface.ClientCommandMode;
import com.kuka.connectivity.fastRobotInterface.FRIConfiguration;
import com.kuka.connectivity.fastRobotInterface.FRIJointOverlay;
import com.kuka.connectivity.fastRobotInterface.FRISession;
import com.kuka.roboticsAPI.applicationModel.RoboticsAPIApplication;
import com.kuka.roboticsAPI.deviceModel.LBR;
import com.kuka.roboticsAPI.geometricModel.Tool;
import com.kuka.roboticsAPI.motionModel.controlModeModel.JointImpedanceControlMode;
import com.kuka.roboticsAPI.uiModel.ApplicationDialogType;

/**
 * Lets spherecal command joint torques through the Fast Robot Interface (FRI).
 *
 * The cabinet compensates gravity, with the load data of the tool template {@link #TOOL}. Its joint impedance has
 * stiffness 0 and damping 0. So what moves the arm is gravity compensation plus the torques of the client.
 *
 * NOT TRIED ON A ROBOT. Read docs/robots/kuka.md first. Begin in T1, with the enabling switch in your hand.
 *
 * For Sunrise.OS 1.11 to 1.16. The names of newer versions stand in README.md beside this file.
 */
public class SpherecalTorqueOverlay extends RoboticsAPIApplication {

    /** The computer that runs spherecal. Its network card must be on the cabinet's FRI network. */
    private static final String CLIENT = "192.170.10.1";

    /** The UDP port of the client. */
    private static final int CLIENT_PORT = 30200;

    /** Time between two messages, ms. spherecal controls at 1 kHz. */
    private static final int SEND_PERIOD_MS = 1;

    /** The cabinet expects an answer to each message. */
    private static final int RECEIVE_MULTIPLIER = 1;

    /** The tool template of the Sunrise project. It holds mass, centre of mass and inertia of the calibration tool. */
    private static final String TOOL = "SpherecalTool";

    /** How long to wait for a good connection, s. */
    private static final int WAIT_S = 60;

    private LBR lbr;
    private Tool tool;

    @Override
    public void initialize() {
        lbr = getContext().getDeviceFromType(LBR.class);
        tool = getApplicationData().createFromTemplate(TOOL);
        // From here on the cabinet's gravity compensation includes the tool.
        tool.attachTo(lbr.getFlange());
    }

    @Override
    public void run() throws Exception {
        FRIConfiguration configuration = FRIConfiguration.createRemoteConfiguration(lbr, CLIENT);
        configuration.setPortOnRemote(CLIENT_PORT);
        configuration.setSendPeriodMilliSec(SEND_PERIOD_MS);
        configuration.setReceiveMultiplier(RECEIVE_MULTIPLIER);

        FRISession session = new FRISession(configuration);
        try {
            getLogger().info("FRI: sending to " + CLIENT + ":" + CLIENT_PORT + " every " + SEND_PERIOD_MS + " ms");
            // Returns as soon as the client answers well enough for commands.
            session.await(WAIT_S, TimeUnit.SECONDS);
            if (mayMove()) {
                hold(session);
            }
        } catch (TimeoutException e) {
            getLogger().error("FRI: no client answered well enough within " + WAIT_S + " s. Start spherecal, check the network.");
        } finally {
            session.close();
        }
    }

    /** Asks the person at the robot. */
    private boolean mayMove() {
        int answer = getApplicationUI().displayModalDialog(ApplicationDialogType.QUESTION,
                "The arm will be as soft as the client's torques make it. Is it clear of everything,"
                        + " is the tool mounted, and is the enabling switch in your hand?",
                "Move", "Cancel");
        return answer == 0;
    }

    /** Holds the pose with stiffness 0 and lays the client's torques over it, until one side ends it. */
    private void hold(FRISession session) {
        JointImpedanceControlMode soft = new JointImpedanceControlMode(0, 0, 0, 0, 0, 0, 0);
        soft.setDampingForAllJoints(0.0);
        FRIJointOverlay torques = new FRIJointOverlay(session, ClientCommandMode.TORQUE);
        // A negative duration: no end of its own. The cabinet ends the motion with its brakes when the client stops
        // answering, when a safety function acts, or when the person stops the application.
        tool.move(positionHold(soft, -1, TimeUnit.SECONDS).addMotionOverlay(torques));
    }
}
