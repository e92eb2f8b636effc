from controller import Robot


class CSVRobot(Robot):
    def __init__(self, timestep):
        super().__init__()
        self.timestep = timestep
        self.emitter, self.receiver = self.getDevice("emitter"), self.getDevice("receiver")
        self.receiver.enable(timestep)

    def handle_emitter(self):
        self.emitter.send(",".join(map(str, self.create_message())).encode())

    def handle_receiver(self):
        if self.receiver.getQueueLength() > 0:
            self.use_message_data(self.receiver.getString().split(","))
            self.receiver.nextPacket()

    def run(self):
        while self.step(self.timestep) != -1:
            self.handle_receiver()
            self.handle_emitter()
