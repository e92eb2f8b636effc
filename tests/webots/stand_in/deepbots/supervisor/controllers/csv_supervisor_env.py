from controller import Supervisor


class CSVSupervisorEnv(Supervisor):
    def __init__(self, timestep):
        super().__init__()
        self.timestep = timestep
        self.emitter, self.receiver = self.initialize_comms("emitter", "receiver")

    def handle_emitter(self, action):
        self.emitter.send(",".join(map(str, action)).encode())

    def handle_receiver(self):
        if self.receiver.getQueueLength() == 0:
            return None
        text = self.receiver.getString()
        self.receiver.nextPacket()
        return text.split(",")
